"""Problem and plant -> a sparse nonlinear program, as data; links join the programs of phases."""
