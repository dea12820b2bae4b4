"""One file for each source of cameras: its configuration, and its row of `novags.cameras.SOURCES`.

They import neither torch nor COLMAP; the code of a source is named as text and imported when it runs.
"""
