"""Models fitted to a subject: by distances of markers, by factors, or by a table of segments."""
