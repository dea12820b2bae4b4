"""`novags video`: a flight through a reconstruction, beside the truth and the dark pictures."""
