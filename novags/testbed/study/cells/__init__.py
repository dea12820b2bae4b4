"""From a preset or a study file to its cells."""
