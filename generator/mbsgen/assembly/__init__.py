"""Assembly: a tree with loops -> the same tree with the pose, the equations and the coordinates to compute with."""

from __future__ import annotations

from mbsgen.assembly.assemble import AssemblyError, assemble, release
from mbsgen.assembly.findings import Findings, describe, list_held, list_redundant
from mbsgen.assembly.poses import reach

__all__ = ["AssemblyError", "Findings", "assemble", "describe", "list_held", "list_redundant", "reach", "release"]
