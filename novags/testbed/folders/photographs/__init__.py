"""Photographs as cameras and others leave them: raw files, linear EXR files, videos."""
