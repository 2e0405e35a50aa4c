"""Calls of an interval's points at once, in lanes of vectors: Tables -> functions for `mbs_program_lanes`.

The points of an interval call the same kernels with other numbers. A function serves several calls where no script
lets one of them read what another of them computes. Then each result has the bits of a call alone. In kernels that
divide by pivots, last digits may differ, since a compiler may contract products and sums differently there.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any

import numpy as np

from mbsrun.binding import Entry
from mbsrun.many import Several
from mbsrun.ocp.evaluation.stages.tables import Call, Script

LANES = 4  # an interval has some three or four points


class Abreast:
    """Functions for several calls at once, by their numbers among the functions of a program."""

    def __init__(self, ffi: Any, functions: Mapping[int, tuple[Entry, Several]], count: int) -> None:
        """Describe some of `count` functions."""
        self._ffi = ffi
        self._kept: list[Any] = []
        self.functions = ffi.new("mbs_program_abreast[]", max(1, count))
        numbers = [0]
        for number, (entry, several) in functions.items():
            sizes = list_sizes(entry)
            own = self.functions[number]
            own.function = ffi.cast("mbs_program_function", several.function)
            own.argument, own.result = (self._keep(ffi.new("int[]", [*part, 0])) for part in sizes)
            numbers.append(sum(map(sum, sizes)))
        self.numbers = LANES * max(numbers)  # of the largest function's calls

    def lay(self, room: Any) -> Any:
        """Return the structure of a worker, whose memory is `room`, numbers in C's memory."""
        return self._ffi.new("mbs_program_lanes *", [LANES, self.functions, room])

    def _keep(self, value: Any) -> Any:
        self._kept.append(value)
        return value


def list_sizes(entry: Entry) -> tuple[list[int], list[int]]:
    """List how many numbers each argument and each result of a kernel has."""
    sizes = [0] * entry.n_in, [0] * entry.n_out
    for own, ports in zip(sizes, (entry.inputs, entry.outputs), strict=True):
        for port in ports:
            own[port.position] = port.argument.nnz
    return sizes


def find_repeated(scripts: Sequence[Script]) -> set[int]:
    """Find the functions that are called several times without terms in between."""
    return {function for script in scripts for function, calls in _list_runs(script) if len(calls) > 1}


def is_independent(scripts: Sequence[Script], function: int, sizes: tuple[Sequence[int], Sequence[int]]) -> bool:
    """Return whether no run of a function's calls reads its own results, and all of a run's leave out the same ones."""
    return all(
        _fits_abreast(calls, sizes) for script in scripts for number, calls in _list_runs(script) if number == function
    )


def _fits_abreast(calls: Sequence[Call], sizes: tuple[Sequence[int], Sequence[int]]) -> bool:
    absent = {(*(x < 0 for x in call.arguments), *(x < 0 for x in call.results)) for call in calls}
    read = _list_places([call.arguments for call in calls], sizes[0])
    return len(absent) == 1 and not np.intersect1d(read, _list_places([c.results for c in calls], sizes[1])).size


def _list_runs(script: Script) -> Iterator[tuple[int, list[Call]]]:
    """Yield the calls of a function that follow each other without terms in between."""
    calls: list[tuple[int, Call]] = []
    begun = 0
    for step in script.steps:
        begun += step.terms is not None and step.terms.to.size > 0
        if step.call is not None:
            calls.append((begun, step.call))
        else:
            begun += 1
    for (_, function), run in groupby(calls, key=lambda item: (item[0], item[1].function)):
        yield function, [call for _, call in run]


def _list_places(starts: Sequence[Sequence[int]], sizes: Sequence[int]) -> np.ndarray[Any, np.dtype[np.intp]]:
    places = [np.arange(x, x + n) for row in starts for x, n in zip(row, sizes, strict=False) if x >= 0]
    return np.concatenate([np.zeros(0, dtype=np.intp), *places])
