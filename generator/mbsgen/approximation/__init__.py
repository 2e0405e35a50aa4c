"""Approximation: a tree with less in it, whose functions differ from the whole one's by no more than a tolerance."""
