"""A scene from outside: loaded, checked, named and hashed."""
