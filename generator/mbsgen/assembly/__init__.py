"""Assembly: a tree with loops -> the same tree with the pose, the equations and the coordinates to compute with."""

from __future__ import annotations

from mbsgen.assembly.entry import assemble, describe, list_held, list_redundant
from mbsgen.assembly.results import AssemblyError, Findings, release

__all__ = ["AssemblyError", "Findings", "assemble", "describe", "list_held", "list_redundant", "release"]
