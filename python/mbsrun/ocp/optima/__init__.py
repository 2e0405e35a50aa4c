"""How an optimum moves: derivatives of solutions by the numbers of their problem, and predictions of neighbours."""
