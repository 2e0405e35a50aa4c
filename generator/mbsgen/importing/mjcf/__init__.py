"""MJCF, the format of MuJoCo: `reading` makes the draft."""
