"""The community's benchmark mechanisms: work and precision of their motions, beside other programs."""
