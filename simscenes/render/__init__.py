"""One view: radiance with its variance, and the geometry behind every pixel, rendered with Mitsuba."""
