"""Speed against accuracy: what kernels and simulations cost, and what they err by, measured and drawn."""
