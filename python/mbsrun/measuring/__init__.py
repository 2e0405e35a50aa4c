"""Measure time and error of kernels, simulations and solves; keep, draw and report the results."""
