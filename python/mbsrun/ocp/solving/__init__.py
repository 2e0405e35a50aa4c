"""One solve: preparation, the search, an independent judge, the re-simulation."""
