"""Measures generated kernels beside what others reach on the same work, in one run: flops, time, and their ratios."""
