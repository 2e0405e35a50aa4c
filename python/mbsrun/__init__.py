"""mbsrun: compile, load and call generated kernels; solve optimal control problems with them."""
