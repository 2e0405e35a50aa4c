"""Closed loops: closing, in closed form where there is one; projections; reduced forms."""
