"""Tables as text of C: StageProgram -> constant arrays and structs; equal arrays are written once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from mbsrun.ocp.evaluation.stages.tables import Call, Kind, Nonzeros, Script, StageProgram, Step, Terms
from mbsrun.ocp.ground.functions import Array, Indices

INFINITE = 1e20  # written for a bound that is not there
Wrap = Callable[[Iterable[str]], tuple[str, ...]]


@dataclass(frozen=True)
class Declared:
    """A constant array: its declaration, and the lines of its initialiser."""

    declaration: str
    lines: tuple[str, ...]


class Arrays:
    """Constant arrays of one file."""

    def __init__(self, prefix: str, wrap: Wrap) -> None:
        """Begin without any; names of arrays begin with the prefix."""
        self._prefix, self._wrap = prefix, wrap
        self._names: dict[tuple[str, tuple[str, ...]], str] = {}
        self.declared: list[Declared] = []

    def put(self, kind: str, words: Sequence[str]) -> str:
        """Write an array, and return its name; NULL if it is empty."""
        if not words:
            return "NULL"
        key = (kind, tuple(words))
        if key not in self._names:
            name = self._names[key] = f"{self._prefix}_t{len(self._names)}"
            self.declared.append(Declared(f"static const {kind} {name}[{len(words)}]", self._wrap(words)))
        return self._names[key]

    def integers(self, numbers: Iterable[int]) -> str:
        """Write whole numbers."""
        return self.put("int", [str(int(x)) for x in numbers])

    def reals(self, numbers: Iterable[float]) -> str:
        """Write numbers."""
        return self.put("mbs_stages_real", [write_real(float(x)) for x in numbers])


def write_real(x: float) -> str:
    """Write a number; an infinite one as the solver reads it."""
    return repr(min(max(float(x), -INFINITE), INFINITE))


@dataclass(frozen=True)
class Written:
    """The initialisers of the tables."""

    sizes: tuple[str, ...]  # of each kind
    kinds: tuple[str, ...]


def write_kinds(tables: StageProgram, arrays: Arrays) -> Written:
    """Write the scripts and patterns of all kinds."""
    sizes = tuple(_write_size(kind, arrays) for kind in tables.kinds)
    kinds = [
        ", ".join(
            (
                f"{{{size}}}",
                *(f"{{{_write_script(script, arrays)}}}" for script in kind.scripts),
            )
        )
        for kind, size in zip(tables.kinds, sizes, strict=True)
    ]
    return Written(sizes, tuple(kinds))


def _write_size(kind: Kind, arrays: Arrays) -> str:
    patterns = ", ".join(_write_pattern(p, arrays) for p in (kind.de, kind.dd, kind.dg, kind.hessian))
    pointer = arrays.put("mbs_stages_patterns", [f"{{{patterns}}}"])
    return f"{kind.nx}, {kind.nv}, {kind.ne}, {kind.ng}, {kind.inner}, {pointer}"


def _write_pattern(pattern: Nonzeros, arrays: Arrays) -> str:
    columns = np.searchsorted(pattern.col, np.arange(pattern.shape[1] + 1))
    row = pattern.row if pattern.row.size else np.zeros(1)
    return f"{{{arrays.integers(columns)}, {arrays.integers(row)}}}"


def _write_script(script: Script, arrays: Arrays) -> str:
    steps = [_write_step(step, arrays) for step in script.steps]
    parts = (
        str(len(steps)),
        arrays.put("mbs_program_step", steps),
        str(script.start.size),
        arrays.reals(script.start),
        str(script.size),
        arrays.integers(script.results),
    )
    return ", ".join(parts)


def _write_step(step: Step, arrays: Arrays) -> str:
    call = "NULL" if step.call is None else f"&{arrays.put('mbs_program_call', [_write_call(step.call, arrays)])}[0]"
    return f"{{{{{_write_terms(step.terms, arrays)}}}, {call}}}"


def _write_terms(terms: Terms | None, arrays: Arrays) -> str:
    if terms is None:
        return "0, NULL, NULL, NULL, NULL"
    by = "NULL" if terms.by is None else arrays.integers(terms.by)
    places = f"{arrays.integers(terms.to)}, {arrays.integers(terms.from_)}, {by}"
    return f"{terms.to.size}, {places}, {arrays.reals(terms.coefficient)}"


def _write_call(call: Call, arrays: Arrays) -> str:
    places = f"{arrays.integers(call.arguments)}, {arrays.integers(call.results)}"
    return f"{{{call.function}, {len(call.arguments)}, {len(call.results)}, {places}}}"


@dataclass(frozen=True)
class Repeated:
    """Rows of numbers of each stage, of which equal ones are written once."""

    of_stage: tuple[int, ...]
    names: tuple[str, ...]  # of the arrays


def repeat(rows: Sequence[Indices], arrays: Arrays) -> Repeated:
    """Write an array for each stage."""
    names = [arrays.integers(row) for row in rows]
    different = list(dict.fromkeys(names))
    return Repeated(tuple(different.index(name) for name in names), tuple(different))


def split(values: Array | Indices, counts: Sequence[int]) -> list[Indices]:
    """Split a vector into parts of the stages."""
    return np.split(values, np.cumsum(counts)[:-1])
