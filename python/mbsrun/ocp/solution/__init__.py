"""Solutions as values, on disk, and as tables; the record of searches."""
