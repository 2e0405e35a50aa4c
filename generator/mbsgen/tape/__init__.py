"""Straight-line programs: types, building, passes, counts, interpretation."""
