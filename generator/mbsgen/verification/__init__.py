"""Verification: what is generated, held against computations that share no plan with it, before anything is written."""
