"""Camera sources that are networks of others, run from the user's own installation with the user's own weights.

None of them is part of this project. There is one file per network: it says which parts of the package are called,
their results and the convention of these. `package` names missing parts and reads weights; `dense` prepares pictures
and makes cameras and points from a network's output for every pixel; `depths` brings its depths to its own cameras or
to known ones.
"""
