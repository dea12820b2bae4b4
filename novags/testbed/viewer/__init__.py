"""`novags view`: runs in a browser, with their cameras, their pictures, and a light level to move."""
