"""Scripts of a stage: Stage -> the terms and calls that compute values, Jacobians and the Hessian, with patterns.

With y = scale * T * F(x, v, p) the results of a use, w = scale * T * lambda their weights, and p_i the weight of a term
of the cost that is multiplied by the factor sigma,

    values       f += p_i y,          e, d, g += y
    Jacobians    df += p_i y',        de, dd, dg += scale (T F' + F dT)
    Hessian      H += (w' F)'' + scale (F'' lambda dT' + dT lambda' F'),      lambda = sigma p_i, or multipliers

A use without a factor T has T = 1 and no derivative by it. Steps are levels: terms of one level read what earlier ones
wrote. Numbers are numbered from the beginning of W; those after the constants from `ROOM` on, until a script is closed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from mbsrun.ocp.evaluation.stages.calls import Signature, Signatures
from mbsrun.ocp.evaluation.stages.intervals import Triplets
from mbsrun.ocp.evaluation.stages.lifting import Stage, Targets, Use, Vector
from mbsrun.ocp.evaluation.stages.tables import (
    Call,
    CalledFunction,
    Derivative,
    Given,
    Kind,
    Nonzeros,
    Script,
    Step,
    Terms,
)
from mbsrun.ocp.ground.functions import Array, Indices

ROOM = 1 << 40  # added to the numbers of entries after the constants
NONE = -1

WEIGHTS, ARGUMENTS, SUMS = range(3)  # levels; calls come after arguments


@dataclass(frozen=True)
class Entries:
    """Entries to add to a matrix: coefficient * W[from_] * W[by], without what is NONE."""

    row: Indices
    col: Indices
    coefficient: Array
    from_: Indices
    by: Indices


class Functions:
    """The functions that scripts call, and the arguments that a plant fills, numbered."""

    def __init__(self) -> None:
        """Begin without any."""
        self.called: list[CalledFunction] = []
        self.given: list[Given] = []
        self._numbers: dict[int, int] = {}
        self._kept: list[Signature] = []

    def number(self, signature: Signature) -> int:
        """Return the number of a function."""
        if id(signature) not in self._numbers:
            known = next((i for i, f in enumerate(self.called) if f == signature.function), None)
            if known is None:
                known = len(self.called)
                self.called.append(signature.function)
            self._numbers[id(signature)] = known
            self._kept.append(signature)  # so that no other one has its id
        return self._numbers[id(signature)]

    def place(self, given: Given) -> int:
        """Return where an argument begins among all that are filled."""
        if given not in self.given:
            self.given.append(given)
        return sum(other.size for other in self.given[: self.given.index(given)])


@dataclass(frozen=True)
class Frame:
    """The sizes that all scripts of a program have in common."""

    parameters: int  # p; arguments that a plant fills follow
    given: int  # entries of these
    numbers: int
    signatures: Signatures
    functions: Functions


def write(stage: Stage, frame: Frame, inner: int) -> Kind:
    """Write the scripts of a stage."""
    n = stage.nx + stage.nv
    values = _write_values(stage, frame)
    jacobians, patterns = _write_jacobians(stage, frame)
    second, hessian = _write_hessian(stage, frame)
    assert hessian.shape == (n, n), "columns for x and v"
    return Kind(
        nx=stage.nx,
        nv=stage.nv,
        ne=stage.ne,
        ng=stage.ng,
        inner=inner,
        de=patterns[Vector.EQUATIONS],
        dd=patterns[Vector.DYNAMICS],
        dg=patterns[Vector.INEQUALITIES],
        hessian=hessian,
        values=values,
        jacobians=jacobians,
        second=second,
    )


_VECTORS = (Vector.EQUATIONS, Vector.DYNAMICS, Vector.INEQUALITIES)


def list_given(uses: Sequence[Use], signatures: Signatures, functions: Functions) -> None:
    """Number all arguments that a plant fills, so that every script knows where they end."""
    for use in uses:
        for _, given in signatures.find(use.function, Derivative.VALUE, use.plant).given:
            functions.place(given)


class _Writer:
    """Writes one script."""

    def __init__(self, stage: Stage, frame: Frame, further: int = 0) -> None:
        self.stage, self.frame = stage, frame
        self.parameters = stage.nx + stage.nv
        self.numbers = self.parameters + frame.parameters + frame.given
        self.multipliers = (
            self.numbers + frame.numbers
        )  # of the Hessian: the cost's factor, then multipliers of all rows
        self.first = self.multipliers + further
        self.start: list[Array] = []
        self.constants = 0
        self.room = 0
        self.terms: list[list[tuple[Indices, Indices, Array, Indices]]] = [[] for _ in range(3)]
        self.calls: list[Call] = []
        self.products: dict[tuple[int, int], int] = {}

    # --- memory ---

    def put(self, values: Array) -> int:
        """Lay constants; return where they begin."""
        self.start.append(values)
        self.constants += values.size
        return self.first + self.constants - values.size

    def zeros(self, size: int) -> int:
        """Lay zeros to which terms add."""
        return self.put(np.zeros(size))

    def take(self, size: int) -> int:
        """Take memory that a call writes."""
        self.room += size
        return ROOM + self.room - size

    # --- terms ---

    def add(
        self,
        level: int,
        to: Indices | int,
        from_: Indices | int,
        coefficient: Array | float = 1.0,
        by: Indices | int = NONE,
    ) -> None:
        """Add terms; where `from_` or `by` is NONE, a term lacks that factor."""
        to, from_, coefficient, by = np.broadcast_arrays(
            np.asarray(to, dtype=np.int64),
            np.asarray(from_, dtype=np.int64),
            np.asarray(coefficient, dtype=np.float64),
            np.asarray(by, dtype=np.int64),
        )
        self.terms[level].append((to.ravel(), from_.ravel(), coefficient.ravel(), by.ravel()))

    def weigh(self, weight: int, factor: int) -> int:
        """Return where the weight of a term of the cost is, times a factor unless that is NONE."""
        at = self.parameters + weight
        if factor == NONE:
            return at
        if (at, factor) not in self.products:
            self.products[at, factor] = self.zeros(1)
            self.add(WEIGHTS, self.products[at, factor], at, 1.0, factor)
        return self.products[at, factor]

    # --- calls ---

    def call(self, use: Use, derivative: Derivative, weights: int = NONE) -> tuple[Signature, list[int]]:
        """Call a function; return where its results begin."""
        signature = self.frame.signatures.find(use.function, derivative, use.plant)
        arguments, results = [NONE] * signature.arguments, [NONE] * signature.results
        for filling, column in zip(signature.inputs, use.columns, strict=True):
            arguments[filling.position] = self.gather(column, filling.varying, filling.values)
        filled = self.parameters + self.frame.parameters
        for position, given in signature.given:
            if given.size:
                arguments[position] = filled + self.frame.functions.place(given)
        if signature.parameters is not None:
            arguments[signature.parameters] = self.gather(self.parameters + use.parameters)
        if signature.data is not None:
            arguments[signature.data] = self.gather(self.numbers + use.data)
        if signature.weights is not None:
            arguments[signature.weights] = weights
        places = []
        for found in signature.found:
            places.append(self.take(found.size) if found.size else NONE)
            results[found.position] = places[-1]
        self.calls.append(Call(self.frame.functions.number(signature), tuple(arguments), tuple(results)))
        return signature, places

    def gather(self, entries: Indices, varying: Indices | None = None, values: Sequence[float] = ()) -> int:
        """Return where entries of W lie one after the other; copy them if they do not."""
        if varying is None:
            if not entries.size:
                return NONE
            if (np.diff(entries) == 1).all():
                return int(entries[0])
            varying, values = np.arange(entries.size), [0.0] * entries.size
        whole = np.array(values, dtype=np.float64)
        whole[varying] = 0.0
        at = self.put(whole)
        self.add(ARGUMENTS, at + varying, entries)
        return at

    def close(self, results: Sequence[int]) -> Script:
        """Make the script."""
        end = self.first + self.constants

        def settle(entries: Indices) -> Indices:
            return np.where(entries >= ROOM, entries - ROOM + end, entries)

        steps: list[Step] = []
        for level, parts in enumerate(self.terms):
            steps += [Step(terms, None) for terms in _collect(parts, settle)]
            if level == ARGUMENTS:
                calls = [
                    Call(
                        call.function,
                        tuple(settle(np.array(call.arguments, dtype=np.int64)).tolist()),
                        tuple(settle(np.array(call.results, dtype=np.int64)).tolist()),
                    )
                    for call in self.calls
                ]
                if calls and steps:
                    steps[-1] = Step(steps[-1].terms, calls[0])
                    calls = calls[1:]
                steps += [Step(None, call) for call in calls]
        start = np.concatenate([np.zeros(0), *self.start])
        return Script(tuple(steps), start, end + self.room, tuple(results))


def _collect(
    parts: Sequence[tuple[Indices, Indices, Array, Indices]], settle: Callable[[Indices], Indices]
) -> list[Terms]:
    """Gather the terms of a level: sums, then products."""
    if not parts:
        return []
    to, from_, coefficient, by = (np.concatenate(column) for column in zip(*parts, strict=True))
    found = []
    for chosen, is_product in ((by == NONE, False), (by != NONE, True)):
        if chosen.any():
            places = [settle(part[chosen]) for part in (to, from_, by)]
            found.append(Terms(places[0], places[1], coefficient[chosen], places[2] if is_product else None))
    return found


# --- the three scripts -----------------------------------------------------------------------------------------------


def _write_values(stage: Stage, frame: Frame) -> Script:
    writer = _Writer(stage, frame)
    cost = writer.zeros(1)
    at = {vector: writer.zeros(rows) for vector, rows in stage.rows.items()}
    for vector in _VECTORS:
        linear = stage.linear[vector]
        writer.add(ARGUMENTS, at[vector] + linear.row, linear.col, linear.value)
    for weight, H in stage.quadratic:
        half = writer.zeros(1)
        writer.add(ARGUMENTS, half, H.row, H.value / 2, H.col)
        writer.add(SUMS, cost, half, 1.0, writer.weigh(weight, NONE))
    for use in stage.uses:
        factor = NONE if use.factor is None else use.factor
        signature, (place,) = writer.call(use, Derivative.VALUE)
        for targets in use.targets:
            chosen, entry = _match(signature.found[0].row, targets.result)
            from_, coefficient = place + signature.found[0].taken[chosen], targets.coefficient[entry]
            row = targets.row[entry]
            if targets.vector is Vector.COST:
                by = np.array([writer.weigh(int(w), factor) for w in row], dtype=np.int64)
                writer.add(SUMS, cost, from_, coefficient, by)
            else:
                writer.add(SUMS, at[targets.vector] + row, from_, coefficient, factor)
    return writer.close((cost, *(at[vector] for vector in _VECTORS)))


def _write_jacobians(stage: Stage, frame: Frame) -> tuple[Script, dict[Vector, Nonzeros]]:
    writer = _Writer(stage, frame)
    n = stage.nx + stage.nv
    gradient = writer.zeros(n)
    entries: dict[Vector, list[Entries]] = {vector: [_constant(stage.linear[vector])] for vector in _VECTORS}
    for weight, H in stage.quadratic:
        writer.add(SUMS, gradient + H.row, H.col, H.value, writer.weigh(weight, NONE))
    for use in stage.uses:
        factor = NONE if use.factor is None else use.factor
        columns = np.concatenate([np.zeros(0, dtype=np.int64), *use.columns])
        signature, places = writer.call(use, Derivative.JACOBIAN)
        for found, place in zip(signature.found, places, strict=True):
            for targets in use.targets:
                chosen, entry = _match(found.row, targets.result)
                from_, coefficient = place + found.taken[chosen], targets.coefficient[entry]
                row, col = targets.row[entry], columns[found.col[chosen]]
                if targets.vector is Vector.COST:
                    by = np.array([writer.weigh(int(w), factor) for w in row], dtype=np.int64)
                    writer.add(SUMS, gradient + col, from_, coefficient, by)
                else:
                    entries[targets.vector].append(_entries(row, col, coefficient, from_, factor))
        if use.factor is None:
            continue
        signature, (place,) = writer.call(use, Derivative.VALUE)
        for targets in use.targets:
            chosen, entry = _match(signature.found[0].row, targets.result)
            from_, coefficient = place + signature.found[0].taken[chosen], targets.coefficient[entry]
            row = targets.row[entry]
            if targets.vector is Vector.COST:
                by = np.array([writer.weigh(int(w), NONE) for w in row], dtype=np.int64)
                writer.add(SUMS, gradient + use.factor, from_, coefficient, by)
            else:
                entries[targets.vector].append(_entries(row, factor, coefficient, from_, NONE))
    patterns, results = {}, [gradient]
    for vector in _VECTORS:
        patterns[vector], at = _assemble(writer, entries[vector], (stage.rows[vector], n))
        results.append(at)
    return writer.close(results), patterns


def _write_hessian(stage: Stage, frame: Frame) -> tuple[Script, Nonzeros]:
    n, rows = stage.nx + stage.nv, stage.rows
    writer = _Writer(stage, frame, further=1 + sum(rows.values()))
    sigma, first = writer.multipliers, {}
    end = sigma + 1
    for vector in _VECTORS:
        first[vector] = end
        end += rows[vector]
    entries: list[Entries] = []

    def multiplier(targets: Targets) -> Indices:
        """Return where the multipliers of rows are; for the cost they are its weights times the factor."""
        if targets.vector is not Vector.COST:
            return first[targets.vector] + targets.row
        return np.array([writer.weigh(int(w), sigma) for w in targets.row], dtype=np.int64)

    for weight, H in stage.quadratic:
        lower = H.row >= H.col
        by = writer.weigh(weight, sigma)
        entries.append(_entries(H.row[lower], H.col[lower], H.value[lower], by, NONE))
    for use in stage.uses:
        signature = frame.signatures.find(use.function, Derivative.HESSIAN, use.plant)
        columns = np.concatenate([np.zeros(0, dtype=np.int64), *use.columns])
        if any(found.row.size for found in signature.found):
            _, places = writer.call(use, Derivative.HESSIAN, _lay_weights(writer, use, signature, multiplier))
            for found, place in zip(signature.found, places, strict=True):
                entries.append(_curve(signature, columns, found.row, found.col, place + found.taken))
        if use.factor is None:
            continue
        signature, places = writer.call(use, Derivative.JACOBIAN)
        for found, place in zip(signature.found, places, strict=True):
            for targets in use.targets:
                chosen, entry = _match(found.row, targets.result)
                col = columns[found.col[chosen]]
                from_, lam = place + found.taken[chosen], multiplier(targets)[entry]
                twice = np.where(col == use.factor, 2.0, 1.0)
                high, low = np.maximum(col, use.factor), np.minimum(col, use.factor)
                entries.append(_entries(high, low, twice * targets.coefficient[entry], from_, lam))
    pattern, begin = _assemble(writer, entries, (n, n))
    return writer.close((begin,)), pattern


def _lay_weights(writer: _Writer, use: Use, signature: Signature, multiplier: Callable[[Targets], Indices]) -> int:
    """Return where the weights of the results of a use lie; they are copied unless they are multipliers as they are."""
    factor = NONE if use.factor is None else use.factor
    result = np.concatenate([signature.weighted[targets.result] for targets in use.targets])
    from_ = np.concatenate([multiplier(targets) for targets in use.targets])
    coefficient = np.concatenate([targets.coefficient for targets in use.targets])
    known = result >= 0
    result, from_, coefficient = result[known], from_[known], coefficient[known]
    is_plain = factor == NONE and result.size == signature.weight_size and bool((coefficient == 1.0).all())
    if is_plain and (result == np.arange(result.size)).all() and (np.diff(from_) == 1).all():
        return int(from_[0])
    at = writer.zeros(signature.weight_size)
    writer.add(ARGUMENTS, at + result, from_, coefficient, factor)
    return at


def _curve(signature: Signature, columns: Indices, row: Indices, col: Indices, from_: Indices) -> Entries:
    """Place second derivatives in the lower triangle."""
    r, c = columns[row], columns[col]
    if not signature.is_lower:
        kept = r >= c
        return _entries(r[kept], c[kept], 1.0, from_[kept], NONE)
    twice = np.where((r == c) & (row != col), 2.0, 1.0)
    return _entries(np.maximum(r, c), np.minimum(r, c), twice, from_, NONE)


# --- entries ---------------------------------------------------------------------------------------------------------


def _match(rows: Indices, wanted: Indices) -> tuple[Indices, Indices]:
    """Return which of some results are requested, and which of the requested ones each of these is."""
    at = np.full(max(rows.max(initial=-1), wanted.max(initial=-1)) + 1, -1)
    at[wanted] = np.arange(wanted.size)
    (chosen,) = np.nonzero(at[rows] >= 0)
    return chosen, at[rows[chosen]]


def _entries(
    row: Indices, col: Indices | int, coefficient: Array | float, from_: Indices | int, by: Indices | int
) -> Entries:
    row, col, from_, by, whole = np.broadcast_arrays(row, col, from_, by, np.asarray(coefficient, dtype=np.float64))
    return Entries(
        row=row.astype(np.int64),
        col=col.astype(np.int64),
        coefficient=whole.astype(np.float64),
        from_=from_.astype(np.int64),
        by=by.astype(np.int64),
    )


def _constant(linear: Triplets) -> Entries:
    return _entries(linear.row, linear.col, linear.value, NONE, NONE)


def _assemble(writer: _Writer, parts: Sequence[Entries], shape: tuple[int, int]) -> tuple[Nonzeros, int]:
    """Sum entries into the nonzeros of a matrix, column by column; return its pattern and where the nonzeros begin."""
    every = [_entries(np.zeros(0, dtype=np.int64), 0, 0.0, 0, 0), *parts]
    row, col = np.concatenate([part.row for part in every]), np.concatenate([part.col for part in every])
    from_, by = np.concatenate([part.from_ for part in every]), np.concatenate([part.by for part in every])
    coefficient = np.concatenate([part.coefficient for part in every])
    places, number = np.unique(col * max(shape[0], 1) + row, return_inverse=True)
    is_constant = from_ == NONE
    start = np.bincount(number[is_constant], weights=coefficient[is_constant], minlength=places.size)
    at = writer.put(start.astype(np.float64))
    other = ~is_constant
    writer.add(SUMS, at + number[other], from_[other], coefficient[other], by[other])
    return Nonzeros(shape, places % max(shape[0], 1), places // max(shape[0], 1)), at
