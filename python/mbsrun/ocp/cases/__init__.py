"""Many problems of the same models: cases, their programs and their outcomes."""
