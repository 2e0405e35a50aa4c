"""Programs as functions with exact derivatives: in CasADi, in NumPy, and in stages for the solver in C."""
