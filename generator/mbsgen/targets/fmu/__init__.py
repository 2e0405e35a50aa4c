"""Functional mock-up units (FMI 2.0 and 3.0) of mechanisms: their numbers, their description, their package."""

from mbsgen.targets.fmu.layout import FmuError, list_functions
from mbsgen.targets.fmu.package import STEP, collect, list_compilable, pack, pack_source
from mbsgen.targets.fmu.versions import VERSIONS

__all__ = [
    "STEP",
    "VERSIONS",
    "FmuError",
    "collect",
    "list_compilable",
    "list_functions",
    "pack",
    "pack_source",
]
