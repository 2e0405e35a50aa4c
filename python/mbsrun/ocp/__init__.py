"""Optimal control: a problem file, a sparse nonlinear program by direct collocation, a checked solution."""
