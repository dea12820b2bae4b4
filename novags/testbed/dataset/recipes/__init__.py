"""What networks train on, made from the captures of a data set: one file a recipe, all named in listed.py."""
