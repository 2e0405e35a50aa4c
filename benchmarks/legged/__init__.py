"""Problems of several phases, with impacts and contacts, beside the same problems written in plain CasADi."""
