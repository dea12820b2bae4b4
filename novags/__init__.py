"""Test bed for low-light 3D reconstruction: NOVA-GS, its rivals, and their score against the truth."""

import os

# torch and numba each bring an OpenMP runtime whose idle threads spin by default. On a machine with few or busy cores
# the spinning of one steals the time of the other (measured: a training step ten times as slow). Must be set before
# torch loads.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
