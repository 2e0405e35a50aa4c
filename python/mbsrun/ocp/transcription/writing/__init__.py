"""Writing: a structure and its plant -> a program, row by row: see `transcription` for the equations.

A sheet holds the layout, and the rows and blocks that are written so far; each module writes one group of them.
"""
