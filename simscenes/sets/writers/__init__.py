"""What a set folder holds for other software, and copies of sets in the layouts of others."""
