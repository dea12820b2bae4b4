"""Test bed for low-light 3D reconstruction: NOVA-GS, its rivals, and their score against the truth."""

import os

# Idle threads of torch's OpenMP spin by default, and steal the time of whatever else runs on a machine with few or busy
# cores. Not spinning at all makes them sleep and wake between the short layers of the denoiser. So they spin briefly.
# Must be set before torch loads.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
os.environ.setdefault("GOMP_SPINCOUNT", "20000")
