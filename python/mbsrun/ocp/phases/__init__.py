"""Problems of several phases with links between them: values, one program, one solve, and a solution of each phase."""
