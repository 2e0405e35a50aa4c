"""The laboratory: cases in which methods lose digits, diverge or mislead, measured on this machine, with verdicts."""
