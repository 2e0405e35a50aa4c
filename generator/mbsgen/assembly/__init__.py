"""Assembly: a tree with loops -> the same tree with the pose, the equations and the coordinates to compute with."""

from __future__ import annotations

from mbsgen.assembly.assemble import AssemblyError, assemble

__all__ = ["AssemblyError", "assemble"]
