"""What a person sees of the work, and the machine that it is done on."""
