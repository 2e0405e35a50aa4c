"""The shape of a model file: its sections, in one schema."""
