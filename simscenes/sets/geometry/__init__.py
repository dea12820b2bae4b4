"""Facts from depth, cameras and points of a set together: tracks, correspondence, and how far the views look."""
