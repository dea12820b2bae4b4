"""Structure from motion by COLMAP (pycolmap): of dark pictures with known lenses, and of photographs without."""
