"""Studies of OpenSim Moco (.omoco) -> a model, and a problem file over it."""
