"""Checks that several configurations share."""


def check_training(steps: int, rate: float, decay: float, batch: int, crop: int) -> None:
    """Refuse settings of a training that cannot be (ValueError)."""
    if steps < 0 or batch < 1 or crop < 1:
        raise ValueError(f"steps must be >= 0, batch and crop >= 1, got {steps}, {batch} and {crop}")
    if not (0 < rate < 1 and 0 <= decay < 1):
        raise ValueError(f"rate must lie in (0, 1) and decay in [0, 1), got {rate} and {decay}")


def check_target(target: float) -> None:
    """Refuse a mean code that no picture can be brought to (ValueError)."""
    if not 0 < target < 1:
        raise ValueError(f"target must lie in (0, 1), got {target}")
