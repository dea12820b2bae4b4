"""Where the dB of a run are lost: one ingredient at a time is replaced by its truth, and the run made again."""
