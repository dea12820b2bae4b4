"""Files of a set folder for other software, and copies of sets in the layouts of others."""
