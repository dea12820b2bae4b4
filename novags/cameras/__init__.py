"""Initial cameras and points for a reconstruction."""
