"""A mechanism to play with: one HTML page that computes with the model's own C, compiled to WebAssembly."""

from mbsrun.playground.machine import PlaygroundError
from mbsrun.playground.page import render_playground, write_playground

__all__ = ["PlaygroundError", "render_playground", "write_playground"]
