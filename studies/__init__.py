"""Studies of questions in the literature, by means of `mbsrun`; not part of the installed package."""
