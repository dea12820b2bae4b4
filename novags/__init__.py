"""Test bed for low-light 3D reconstruction: NOVA-GS, its rivals, and their score against the truth."""
