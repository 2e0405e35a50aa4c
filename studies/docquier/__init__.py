"""Repeat and extend the study of Docquier, Brüls and Fisette: formulations of multibody dynamics in optimal control."""
