"""Test bed for low-light 3D reconstruction: NOVA-GS, its rivals, and their score against the truth."""

import os

# Idle threads of torch's OpenMP spin by default, and steal the time of whatever else runs on a machine with few or busy
# cores. Not spinning at all makes them sleep and wake between the short layers of the denoiser. So they spin briefly.
# Must be set before torch loads.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
os.environ.setdefault("GOMP_SPINCOUNT", "20000")

# On busy cores MKL sums small products of matrices in an order that changes from call to call, unless told not to: the
# last bits of a network's gradients, and of resumed fits of small pictures, would change. Must be set before its first
# use.
os.environ.setdefault("MKL_CBWR", "AUTO")
