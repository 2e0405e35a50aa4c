"""Studies beside `mbsrun`, which knows none of their modules: a paper's, and the laboratory of methods that fail."""
