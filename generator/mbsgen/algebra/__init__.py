"""Vectors and rotations in three dimensions, over whatever numbers they are given."""
