"""The cost of accuracy in time: every knob measured, its curve, its Pareto front, and the default on it."""
