"""Published examples of OpenSim Moco, solved by both programs on the same grids: see `__main__`."""
