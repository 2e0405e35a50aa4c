"""Functions with exact derivatives of a program: `casadi` for solvers in CasADi, `numpy` for any other."""
