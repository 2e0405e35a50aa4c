"""The steps of a simulation: one file a family of methods, by name in `methods`; joints that stick, slide or stop."""
