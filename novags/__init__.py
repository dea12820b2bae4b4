"""Test bed for low-light 3D reconstruction: NOVA-GS, its rivals, and their score against the truth."""

import os

# Idle threads of torch's OpenMP spin by default, and steal the time of whatever else runs on a machine with few or busy
# cores (measured: a training step ten times as slow). Not spinning at all makes a denoiser step twice as slow on two
# free ones (125 against 60 ms), since its layers are short. So they spin for some ten microseconds. Must be set before
# torch loads.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
os.environ.setdefault("GOMP_SPINCOUNT", "20000")
