"""Common parts of the faces of JAX and PyTorch: operators on nonzeros, functions by name, and steps."""
