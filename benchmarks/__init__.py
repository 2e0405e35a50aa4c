"""Compare generated kernels with other programs for the same work, in one run: flops, times, and their ratios."""
