"""Model predictive controllers in C: a problem file -> a folder of C that solves it, and that folder from Python."""
