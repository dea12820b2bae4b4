"""What depth, cameras and points of a set say together: tracks, correspondence, and how far the views look."""
