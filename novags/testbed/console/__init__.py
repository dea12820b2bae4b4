"""The display of the work, and the machine that it is done on."""
