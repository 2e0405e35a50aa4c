"""Model predictive control of a Panda: solvers side by side, all given the generated kernels."""
