"""Finished results beside each other and beside what is asked for now, and the commands that make them again."""
