"""Benchmarks of mechanisms with loops: the community's models, references, and other programs for the same work."""
