"""Numbers of a problem by their places in its file, such as `constants.kerb`, `cost.running[0].weight`.

Every number of the data has a name, and so have numbers that the data leave out: coordinates and velocities of the
start, and parameters of the models. A range has `lower` and `upper`. A text of constants is a number, too.
"""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from mbsgen.documents import Data, Place, WrongValueError, nearest, read_number
from mbsgen.expressions import FLOATS, ExpressionError, evaluate
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.optima.questions import Number
from mbsrun.ocp.problem.phases import PhasedProblem
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.statement.checks import ProblemError

_INDEX = re.compile(r"\[(\d+)\]")
_KEY = re.compile(r"[^.\[]*")
_ENDS = ("lower", "upper")
_NO_NUMBERS = (  # keys whose numbers are no part of the optimum
    "accuracy", "degree", "guess", "intervals", "model", "refine", "references", "relaxation", "scheme", "solver",
    "steps",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Source:
    """A problem as data, and how other data are stated."""

    name: str
    data: Mapping[str, Data]
    left_out: Mapping[str, float]  # names of numbers that the data leave out, with their values
    state: Callable[[Mapping[str, Data]], PhasedProblem]

    def list_names(self) -> tuple[str, ...]:
        """List the names of all numbers."""
        found = dict.fromkeys(name for name, _ in self._every())
        return (*found, *(name for name in self.left_out if name not in found))

    def find(self, name: str) -> Number:
        """Return a number by its name. Raises ProblemError for a name that is none."""
        place, value = self._look(name)
        return Number(name, value, lambda x: self.state(put_at(self.data, place, x)))

    def put(self, numbers: Mapping[str, float]) -> Mapping[str, Data]:
        """Return the data with other values of numbers. Raises ProblemError for a name that is none."""
        data = self.data
        for name, value in numbers.items():
            data = put_at(data, self._look(name)[0], float(value))
        return data

    def _look(self, name: str) -> tuple[Place, float]:
        """Return the place of a number, and its value."""
        place = _read_place(name, self.data)
        if name in self.left_out:
            first, second, *_ = name.split(".")
            keys = (first, second) if first == "start" else (first,)
            place = (*keys, name.removeprefix(".".join(keys) + "."))
        leaf = _look(self.data, place)
        if leaf is None and name in self.left_out:
            leaf = self.left_out[name]
        value, known = self._evaluate(leaf), self.list_names()
        if value is None or _write(place, self.data) not in (*known, name if name in known else ""):
            meant = nearest(name, known)
            finding = "it is no number of the problem" if leaf is None else f"found {leaf!r}, which is no number"
            remedy = f"did you mean {meant}?" if meant else f"give one of {', '.join(known)}"
            raise ProblemError(self.name, [(name, finding, remedy)])
        return place, value

    def _every(self) -> Iterator[tuple[str, Data]]:
        kept = {key: value for key, value in self.data.items() if key not in _NO_NUMBERS}
        for place, leaf in _list_leaves(kept, ()):
            if self._evaluate(leaf) is not None:
                yield _write(place, self.data), leaf

    def _evaluate(self, leaf: Data) -> float | None:
        """Return the value of a number or of a text of constants; None for anything else."""
        return _evaluate(leaf, self._constants)

    @cached_property
    def _constants(self) -> Mapping[str, float]:
        given, found = self.data.get("constants"), dict[str, float]()
        for name, leaf in given.items() if isinstance(given, dict) else ():
            value = _evaluate(leaf, found)
            if value is not None:
                found[name] = value
        return found


class Numbered(ABC):
    """A problem in Python whose numbers have names."""

    @property
    @abstractmethod
    def _source(self) -> Source: ...

    @property
    def numbers(self) -> tuple[str, ...]:
        """List the names of all numbers of the problem that solutions may be differentiated by."""
        return self._source.list_names()

    def read_number(self, name: str) -> float:
        """Return the value of a number. Raises ProblemError for a name that is none."""
        return self._source.find(name).value

    def check_numbers(self, names: Sequence[str]) -> None:
        """Raise ProblemError for a name that is no number of the problem."""
        for name in names:
            self._source.find(name)


def list_left_out(problem: Problem, plant: Plant, data: Mapping[str, Data]) -> dict[str, float]:
    """Return numbers that the data of a problem need not give: of the start of a tree, and parameters of the model."""
    manifest, found = plant.manifest, dict[str, float]()
    start = data.get("start")
    given = start if isinstance(start, dict) else {}
    if not manifest.dependent and not problem.has_quaternions:
        coordinates, nq = tuple(c.name for c in manifest.coordinates), len(problem.start_q)
        for key, names, values, first in (
            ("pose", manifest.positions, problem.start_q, 0),
            ("velocity", coordinates, problem.start_qd, nq),
        ):
            if isinstance(given.get(key, {}), dict):
                pairs = enumerate(zip(names, values, strict=True))
                found |= {f"start.{key}.{name}": x for i, (name, x) in pairs if first + i not in problem.free_start}
    return found | {f"parameters.{p.name}": plant.parameters[p.name] for p in manifest.design}


def _evaluate(leaf: Data, constants: Mapping[str, float]) -> float | None:
    if isinstance(leaf, bool) or not isinstance(leaf, int | float | str):
        return None
    try:
        value = float(evaluate(read_number(leaf), constants, FLOATS))
    except (ExpressionError, WrongValueError, KeyError):
        return None
    return value if math.isfinite(value) else None


def _list_leaves(data: Data, place: Place) -> Iterator[tuple[Place, Data]]:
    if isinstance(data, dict | list):
        for key, value in data.items() if isinstance(data, dict) else enumerate(data):
            if key not in ("expression", "rate", "name", "at", "sensor", "model", *_NO_NUMBERS):
                yield from _list_leaves(value, (*place, key))
    else:
        yield place, data


def _is_range(data: Mapping[str, Data], place: Place) -> bool:
    """Return whether a place is an end of a range: a list of two under bounds, or under a key `range` or `rates`."""
    if not place or not isinstance(place[-1], int):
        return False
    above = _look(data, place[:-1])
    named = place[-2] if len(place) > 1 else ""
    return (
        isinstance(above, list)
        and len(above) == 2
        and (place[0] == "bounds" or "bounds" in place or named in ("range", "rates"))
    )


def _write(place: Place, data: Mapping[str, Data]) -> str:
    if _is_range(data, place):
        return f"{_write(place[:-1], data)}.{_ENDS[int(place[-1])]}"
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in place).removeprefix(".")


def _read_place(name: str, data: Mapping[str, Data]) -> Place:
    """Return the place of a name: keys may hold dots, so the longest one that fits counts."""
    place: Place = ()
    while name:
        above = _look(data, place)
        key: str | int
        if index := _INDEX.match(name):
            key, name = int(index[1]), name[index.end() :]
        else:
            name = name.removeprefix(".")
            known = list(above) if isinstance(above, Mapping) else []
            fitting = [k for k in known if isinstance(k, str) and _begins(name, k)]
            word = max(fitting, key=len, default=_take_key(name))
            key = _ENDS.index(word) if isinstance(above, list) and word in _ENDS else word
            name = name[len(word) :]
        place = (*place, key)
    return place


def _take_key(name: str) -> str:
    found = _KEY.match(name)
    return found[0] if found and found[0] else name


def _begins(name: str, key: str) -> bool:
    return name == key or name.startswith((f"{key}.", f"{key}["))


def _look(data: Data | Mapping[str, Data], place: Place) -> Data:
    found: object = data
    for key in place:
        if isinstance(found, Mapping) and isinstance(key, str):
            found = found.get(key)
        elif isinstance(found, list) and isinstance(key, int) and key < len(found):
            found = found[key]
        else:
            return None
    return found  # type: ignore[return-value]


class WrongPlaceError(Exception):
    """A place that does not exist, and cannot be made: what was found, and the key that it lacks."""

    def __init__(self, found: Any, key: str | int) -> None:
        super().__init__(f"{key} of {found!r}")
        self.found, self.key = found, key


def put_at(data: Any, place: Place, value: Data) -> Any:
    """Return data with another value at a place; mappings on the way are made.

    Raises WrongPlaceError where the place has no such entry of a list, or no mapping.
    """
    if not place:
        return value
    key, *rest = place
    if isinstance(key, int):
        if not isinstance(data, list) or key >= len(data):
            raise WrongPlaceError(data, key)
        return [*data[:key], put_at(data[key], tuple(rest), value), *data[key + 1 :]]
    if data is not None and not isinstance(data, Mapping):
        raise WrongPlaceError(data, key)
    held = dict(data or {})
    held[key] = put_at(held.get(key), tuple(rest), value)
    return held
