"""A model made into another: the scene of one use, locked joints, numbers at run time; and its Tree."""
