"""Checks of the meaning of a model: names, forces, loops, stops, motions that are not determined."""
