"""Kernels in the words of other programs for optimal control; each is imported only where it is used."""
