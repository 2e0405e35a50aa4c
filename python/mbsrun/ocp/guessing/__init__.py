"""First guesses: from starts and ends, recordings and earlier solutions, and random ones."""
