"""Methods of other people on our Gaussians, one file each: from their equations and published constants."""
