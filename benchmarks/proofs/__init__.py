"""Proofs that discrete problems of optimal control have a strict local minimum within a small ball."""
