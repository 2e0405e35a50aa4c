"""Targets: a tape written in another language."""
