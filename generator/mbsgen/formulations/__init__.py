"""Recursions over the Tree, each written to a Tape."""
