"""mbsgen: a multibody model in, equation tapes, C kernels and their derivatives out."""

__version__ = "0.1.0"
