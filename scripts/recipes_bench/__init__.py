"""Networks trained on the recipes of a data set, and the classical methods that they are measured against."""
