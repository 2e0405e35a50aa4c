"""Optimal control with generated kernels beside plain CasADi: the same program, solved in turn in one run."""
