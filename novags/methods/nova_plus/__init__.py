"""`nova-plus`: a method in which every step follows the known noise."""
