"""Closed loops: a predictive controller, a simulated plant and its disturbances in; the motion and its figures out."""
