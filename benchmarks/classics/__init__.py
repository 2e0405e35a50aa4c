"""Published problems of optimal control, solved by `mbsrun` and by plain CasADi on the same mesh, in one run."""
