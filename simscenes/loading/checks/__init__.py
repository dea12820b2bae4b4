"""Checks of a scene before Mitsuba has to live with it: files, numbers, and a trial in another process."""
