"""A camera of somebody's own: from dark and flat frames, and its darkness from dark frames alone."""
