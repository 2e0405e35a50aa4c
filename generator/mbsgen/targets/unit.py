"""The unit of generation: the functions of one model, and the values and names that are written with them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from mbsgen.targets.contract import Family
from mbsgen.targets.entries import Group
from mbsgen.targets.parts import LENGTH


@dataclass(frozen=True)
class Unit:
    """The functions of one model, to be written in each target language."""

    prefix: str  # the model's mangled name
    version: str  # of mbsgen
    model_hash: str
    families: tuple[Family, ...]
    parameters: tuple[float, ...] = ()  # default values of the run-time parameters
    design: tuple[float, ...] = ()  # values of the differentiated parameters
    only_driven: bool = True  # u is the only force in the joints
    groups: tuple[Group, ...] = ()  # names of the entries of vectors
    references: Mapping[str, tuple[float, ...]] = field(default_factory=dict)  # results at the check's first state
    tolerance: float | None = None  # allowed relative error of the functions; None: exact
    headers: tuple[str, ...] = ()  # that target languages add, to be installed
    widths: tuple[int, ...] = ()  # states at once, for which the library holds further versions of the kernels
    part: int = LENGTH  # least lines of a part of a long function
    own: str = ""  # the prefix of symbols in C, with the tag; known when the C is written

    @property
    def has_loops(self) -> bool:
        """Return whether loops or constraints restrict the mechanism."""
        return any(group.name == "loop" for group in self.groups)
