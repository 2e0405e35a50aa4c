"""Models of OpenSim: `reading` makes the draft."""
