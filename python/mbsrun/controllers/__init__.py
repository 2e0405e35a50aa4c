"""Model predictive controllers in C: a problem -> a folder of C that solves it; and such a folder, from Python."""
