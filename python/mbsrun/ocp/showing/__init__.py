"""Solutions for people: summaries, pictures, the files of phases."""
