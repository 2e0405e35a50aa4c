"""Identification of inertias and frictions."""
