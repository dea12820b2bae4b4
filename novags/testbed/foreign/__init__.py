"""What comes from elsewhere and goes there: pictures and methods of other programs, results in the layout of others."""
