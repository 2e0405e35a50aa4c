"""Optimal control in Python: problems of values and names, solutions as arrays by name, pictures in a notebook."""
