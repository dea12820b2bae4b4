"""The hard cases, one file a part of the project."""
