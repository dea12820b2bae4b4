"""The report on a study: its combinations in tables, over the light, in pictures, with what they cost."""
