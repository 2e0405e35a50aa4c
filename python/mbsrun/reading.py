"""Settings of a command: a file's data, replaced in part by options; numbers, formulas and names, with their faults.

Options replace the file's data before anything is checked, so both follow the same rules. Numbers may be expressions
over the file's `constants`.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from mbsgen.documents import Data, Document, Place, abbreviate, lies_under, nearest, read_document, write_path
from mbsgen.errors import Fault
from mbsgen.expressions import FLOATS, Expression, ExpressionError, evaluate, names

COMMAND_LINE = "command line"
ENDLESS = 1e19  # solvers read limits of this magnitude or more as none


def read_settings(file: Path | None, options: Mapping[str, Data]) -> Document:
    """Read a settings file, if there is one, with its values replaced by options, which are nested as in a file."""
    document = Document("", {}, {}, {}) if file is None else read_document(file)
    if not isinstance(document.data, dict):
        return document
    return replace(document, data=overlay(document.data, dict(options)))


def overlay(below: Data, above: Data) -> Data:
    """Return the data `below`, with values replaced where `above` has them."""
    if isinstance(below, dict) and isinstance(above, dict):
        return {**below, **{key: overlay(below.get(key), value) for key, value in above.items()}}
    return above


def attribute(faults: Sequence[Fault], options: Mapping[str, Data], file: Path | None) -> list[Fault]:
    """Name the command line where an option is at fault, or where there is no file."""
    spelled = tuple(write_path(place) for place in _leaves(dict(options)))
    return [
        replace(fault, file=COMMAND_LINE, line=0)
        if file is None or any(fault.path.startswith(option) for option in spelled)
        else fault
        for fault in faults
    ]


def _leaves(options: Data, place: Place = ()) -> Iterator[Place]:
    if isinstance(options, dict):
        for key, value in options.items():
            yield from _leaves(value, (*place, key))
    else:
        yield place


def relate(faults: Sequence[Fault], document: Document, place: Place) -> list[Fault]:
    """Name the line that gives a file, where the file as a whole is at fault, as one that is missing."""
    return [
        fault if fault.line or fault.path else document.fault(place, f"{fault.file}: {fault.finding}", fault.remedy)
        for fault in faults
    ]


class Reading:
    """Evaluates numbers and looks names up; collects the faults."""

    def __init__(self, document: Document, stand_ins: frozenset[Place]) -> None:
        self.document, self.stand_ins = document, stand_ins
        self.faults: list[Fault] = []
        self.constants: dict[str, float] = {}

    def number(self, place: Place, expression: Expression, least: float = -math.inf) -> float:
        """Compute an expression; return NaN, which passes all later checks, where it fails or is less than `least`."""
        if lies_under(place, self.stand_ins) or any(math.isnan(self.constants.get(n, 0)) for n in names(expression)):
            return math.nan
        try:
            value = evaluate(expression, self.constants, FLOATS)
        except ExpressionError as error:
            self.fault(place, error.finding, error.remedy)
            return math.nan
        if value < least:
            wanted = {0: "a number that is not negative", math.ulp(0): "a positive number"}
            self.fault(place, f"found {value:g}", f"give {wanted.get(least, f'at least {least:g}')}")
            return math.nan
        return value

    def range(self, place: Place, limits: tuple[Expression | None, Expression | None]) -> tuple[float, float]:
        """Read a lower and an upper limit, infinite where there is none; NaN, which passes later checks, if wrong."""
        lower, upper = (
            default if limit is None else self.limit((*place, i), limit)
            for i, (limit, default) in enumerate(zip(limits, (-math.inf, math.inf), strict=True))
        )
        if lower > upper:
            self.fault(place, f"{lower:g} is above {upper:g}", "give [lower, upper]; null is no bound")
            return (math.nan, math.nan)
        return (lower, upper)

    def limit(self, place: Place, expression: Expression) -> float:
        """Compute a number that limits or fixes an unknown of a solver."""
        value = self.number(place, expression)
        if abs(value) >= ENDLESS:
            finding = f"found {value:g}, and solvers read {ENDLESS:g} and more as no limit"
            self.fault(place, finding, "give null for no limit, or choose a larger unit")
            return math.nan
        return value

    def formula(self, place: Place, expression: Expression, known: Collection[str]) -> bool:
        """Return whether the names of an expression are known: constants, and the names of `known`."""
        every = [*known, *self.constants]
        unknown = sorted(names(expression) - set(every))
        for name in unknown:
            meant = nearest(name, every)
            remedy = f"did you mean {abbreviate(meant)}?" if meant else f"known here are {', '.join(every)}"
            self.fault(place, f"unknown name {abbreviate(name)}", remedy)
        is_known = not unknown and all(math.isfinite(self.constants.get(n, 0)) for n in names(expression))
        return is_known and not lies_under(place, self.stand_ins)

    def find(self, place: Place, name: str, known: Sequence[str], kind: str, owner: str = "model") -> int | None:
        """Look a name up among the ones of an owner; report it where it is unknown."""
        if name in known:
            return list(known).index(name)
        meant = nearest(name, list(known))
        remedy = f"did you mean {abbreviate(meant)}?" if meant else f"there are {', '.join(known) or 'none'}"
        self.fault(place, f"the {owner} has no {kind} {abbreviate(name)}", remedy)
        return None

    def fault(self, place: Place, finding: str, remedy: str) -> None:
        """Keep a fault, unless it follows from one that is kept."""
        if not lies_under(place, self.stand_ins):
            self.faults.append(self.document.fault(place, finding, remedy))
