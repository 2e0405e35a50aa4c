"""Python: one module a model, over any number type."""
