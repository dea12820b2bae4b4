"""`nova-plus`: what the same dark captures give when every step follows the known noise."""
