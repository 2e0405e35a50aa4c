"""Functions of a motion: energies, poses, velocities, reactions, forces of elements."""
