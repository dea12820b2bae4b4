"""Published methods on our Gaussians, one file each, written from their equations and published constants."""
