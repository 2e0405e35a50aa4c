"""Problem files: YAML -> a problem, or all the faults of the file at once."""
