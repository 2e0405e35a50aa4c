"""Fuzzing by hand and in slices: `python -m tests.fuzz KIND --count N --seed S`."""
