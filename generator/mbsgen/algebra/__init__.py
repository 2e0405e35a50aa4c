"""Vectors and rotations in three dimensions, over any numbers."""
