"""The commands of `mbsgen`: a file for each; `console` for messages, `importing` for the options of imports."""
