"""A program in stages: what the solver in C takes; tables of a transcription, and their functions in C."""
