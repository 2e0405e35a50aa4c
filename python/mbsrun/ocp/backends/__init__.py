"""What makes functions with exact derivatives of a program: `casadi` for solvers in it, `numpy` for any other."""
