"""The commands of `mbsrun`: a file for each, and `console` for the options and messages that they share."""
