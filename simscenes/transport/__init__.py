"""Which light transport a scene needs, with the error of leaving the rest out."""
