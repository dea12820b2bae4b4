"""Camera sources that are networks of others, run from the user's own installation with the user's own weights.

Nothing of them is part of this project. One file a network: it says which parts of the package are called, what comes
back and in which convention. `package` says what is missing and reads weights; `dense` prepares pictures and makes
cameras and points of what a network says of every pixel.
"""
