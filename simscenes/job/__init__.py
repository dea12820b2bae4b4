"""A whole set: every view of a rig rendered into a folder."""
