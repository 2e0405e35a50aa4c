"""The project's linear solver beside MUMPS, on optimal control problems from the literature."""
