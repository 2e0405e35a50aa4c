"""Reference results in 50 digits by the textbook recursion: residual, mass matrix, accelerations, derivatives.

    M e_i = Phi(q, 0, e_i) - Phi(q, 0, 0),    c = Phi(q, qd, 0)

    r = Phi - Q - J^T lam - D tau = 0,    J qdd + gamma = 0,    D^T qdd = a

With closed loops J qdd + gamma = 0 and driven joints D^T qdd = a, accelerations come with the forces lam and tau.
Derivatives of r are central differences with a step of 1e-15: in 50 digits their error is about 1e-28. Derivatives of
solutions follow from the implicit function theorem. The recursion shares no code with kernels.

The reduced equations are the same ones at qd and qdd with J qd = 0 and J qdd + gamma = 0, of which the independent
entries yd and ydd are given; their residual is what independent joints feel beside lam: r = E Phi_red, with the columns
of E the independent unit vectors. So it is the force of driven independent joints.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import mpmath
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Numbers = Sequence[Any]
Arguments = Mapping[str, Numbers]
Rows = list[list[Any]]

DIGITS = 50
STEP = "1e-15"  # of central differences; the error is of second order


class Equations(Protocol):
    """The equations of motion of a model, as `mbsgen.oracle.Oracle` has them."""

    driven: tuple[int, ...]
    independent: tuple[int, ...]

    @property
    def inputs(self) -> tuple[str, ...]:
        """Return the names of the inputs of `evaluate`."""

    def evaluate(self, arguments: Arguments) -> dict[str, list[Any]]:
        """Compute Phi and Q."""

    def close(self, arguments: Arguments) -> tuple[Rows, list[Any]]:
        """Compute J by rows, and gamma."""


class Reference:
    """The equations of motion of a model file, in 50 digits."""

    def __init__(self, model: Path) -> None:
        """Read a model file. Raises InputError with all faults."""
        from mbsgen.oracle import Oracle  # imported late: everything else works without SymPy

        self._equations: Equations = Oracle(model)
        self.context = mpmath.MPContext()
        self.context.dps = DIGITS

    def at(self, state: Mapping[str, Array]) -> Moment:
        """Return the equations at one state: q, qd, qdd (n,), u (m,), and the other inputs of the model."""
        exact = {name: [self.context.mpf(float(x)) for x in values] for name, values in state.items()}
        return Moment(exact, self._equations, self.context)


@dataclass(frozen=True)
class Moment:
    """One state. Matrices are lists of rows; all numbers have 50 digits. Without lam and tau, these are 0."""

    state: Arguments
    equations: Equations
    context: Any

    @property
    def size(self) -> int:
        """Count the coordinates."""
        return len(self.state["qdd"])

    # --- forces ---

    def residual(self, **changes: Numbers) -> list[Any]:
        """Compute Phi - Q - J^T lam - D tau here, or with other values of some inputs."""
        state = {**self.state, **changes}
        found, J = self.equations.evaluate(state), self.equations.close(state)[0] if state.get("lam") else []
        rest = [a - b for a, b in zip(found["Phi"], found["Q"], strict=True)]
        for row, force in zip(J, state.get("lam", ()), strict=False):
            rest = [r - x * force for r, x in zip(rest, row, strict=True)]
        for i, force in zip(self.equations.driven, state.get("tau", ()), strict=False):
            rest[i] -= force
        return rest

    @cached_property
    def forces(self) -> list[Any]:
        """Compute Q: inputs, springs, dampers, friction."""
        return self.equations.evaluate(self.state)["Q"]

    @cached_property
    def bias(self) -> list[Any]:
        """Compute c, the residual without accelerations and Q."""
        return self.equations.evaluate({**self.state, "qdd": [0] * self.size})["Phi"]

    @cached_property
    def M(self) -> Rows:
        """Compute the mass matrix."""
        n = self.size
        still = self.residual(qd=[0] * n, qdd=[0] * n)
        columns = [self.residual(qd=[0] * n, qdd=_unit(n, i)) for i in range(n)]
        return [[columns[j][i] - still[i] for j in range(n)] for i in range(n)]

    @cached_property
    def loops(self) -> tuple[Rows, list[Any]]:
        """Compute J and gamma."""
        return self.equations.close(self.state)

    # --- accelerations ---

    @cached_property
    def solution(self) -> dict[str, list[Any]]:
        """Solve for qdd, lam and tau, by name."""
        right = [Q - c for Q, c in zip(self.forces, self.bias, strict=True)]
        right += [-x for x in self.loops[1]] + list(self.state.get("a", [0] * len(self.equations.driven)))
        return self._split(self.solve(right))

    @property
    def qdd(self) -> list[Any]:
        """Return the accelerations that the forces cause."""
        return self.solution["qdd"]

    def solve(self, right: Numbers) -> list[Any]:
        """Solve M x = right; with loops and driven joints, M is bordered by their equations."""
        return list(self.context.lu_solve(self._matrix, self.context.matrix(list(right))))

    def differentiate(self, name: str) -> dict[str, Rows]:
        """Differentiate the solution by an input: for each of qdd, lam and tau, a row for each entry of the input."""
        return self.divide(self.vary(self.balance, name, **self.solution))

    def slopes(self, name: str, **changes: Numbers) -> Rows:
        """Differentiate the residual by an input: a row for each entry of the input."""
        return self.vary(self.residual, name, **changes)

    def scale(self, solution: Mapping[str, Numbers]) -> Array:
        """Compute |M| |qdd| + |c| + |Q| + |J^T| |lam| + |tau| and |J| |qdd| + |gamma| + |a|, entry by entry."""
        n, (J, gamma) = self.size, self.loops
        size = np.abs(np.array(self._matrix.tolist(), dtype=np.float64)) @ np.abs(
            np.array([x for name in ("qdd", "lam", "tau") for x in solution.get(name, ())], dtype=np.float64)
        )
        rest = [abs(c) + abs(Q) for c, Q in zip(self.bias, self.forces, strict=True)]
        rest += [abs(x) for x in (*gamma, *self.state.get("a", [0] * len(self.equations.driven)))]
        assert len(rest) == n + len(J) + len(self.equations.driven), "each equation has a scale"
        return size + np.array(rest, dtype=np.float64)

    @cached_property
    def _matrix(self) -> Any:
        J, driven, n = self.loops[0], self.equations.driven, self.size
        borders = [*J, *(_unit(n, i) for i in driven)]
        rows = [[*row, *(-border[i] for border in borders)] for i, row in enumerate(self.M)]
        return self.context.matrix(rows + [[*border, *[0] * len(borders)] for border in borders])

    def balance(self, **changes: Numbers) -> list[Any]:
        """Compute the residuals of all equations, at qdd, lam and tau among other inputs."""
        state = {**self.state, **changes}
        (J, gamma), qdd = self.equations.close(state), state["qdd"]
        opening = [_dot(row, qdd) + x for row, x in zip(J, gamma, strict=True)]
        asked = state.get("a", [0] * len(self.equations.driven))
        return (
            self.residual(**changes) + opening + [qdd[i] - x for i, x in zip(self.equations.driven, asked, strict=True)]
        )

    def _split(self, x: Numbers) -> dict[str, list[Any]]:
        n, m = self.size, len(self.loops[0])
        parts = {"qdd": list(x[:n]), "lam": list(x[n : n + m]), "tau": list(x[n + m :])}
        return {name: part for name, part in parts.items() if part or name == "qdd"}

    def divide(self, rows: Rows) -> dict[str, Rows]:
        """Return the changes of a solution, for rows of changes of the equations."""
        found = [self._split([-x for x in self.solve(row)]) for row in rows]
        return {name: [own[name] for own in found] for name in self.solution}

    def vary(self, function: Callable[..., list[Any]], name: str, **changes: Numbers) -> Rows:
        """Differentiate a function of inputs by one of them: a row for each entry of it."""
        step, state = self.context.mpf(STEP), {**self.state, **changes}
        rows = []
        for k in range(len(state[name])):
            low, high = list(state[name]), list(state[name])
            low[k], high[k] = low[k] - step, high[k] + step
            ends = function(**{**changes, name: high}), function(**{**changes, name: low})
            rows.append([(b - a) / (2 * step) for b, a in zip(*ends, strict=True)])
        return rows

    # --- reduced equations ---

    @cached_property
    def reduced(self) -> Reduced:
        """Return the equations of the independent coordinates, with their velocities yd and accelerations ydd."""
        return Reduced(self)


@dataclass(frozen=True)
class Reduced:
    """The reduced equations in one state; q is closed, or all but closed."""

    moment: Moment

    @property
    def independent(self) -> tuple[int, ...]:
        """Return the independent entries of qd."""
        return self.moment.equations.independent

    def complete(self, **changes: Numbers) -> Moment:
        """Return the state with the velocities and accelerations that belong to yd and ydd."""
        state = {**self.moment.state, **changes}
        J, _ = self.moment.equations.close(state)
        qd = self._follow(J, [0] * len(J), state["yd"])
        _, gamma = self.moment.equations.close({**state, "qd": qd})
        qdd = self._follow(J, [-x for x in gamma], state["ydd"])
        return replace(self.moment, state={**state, "qd": qd, "qdd": qdd})

    def _follow(self, J: Rows, right: Numbers, y: Numbers) -> list[Any]:
        """Solve J x = right for the x with the independent entries y."""
        context, n = self.moment.context, self.moment.size
        rows = [*J, *(_unit(n, i) for i in self.independent)]
        return list(context.lu_solve(context.matrix(rows), context.matrix([*right, *y])))

    def residual(self, **changes: Numbers) -> list[Any]:
        """Compute Phi_red."""
        moment = self.complete(**changes)
        return self._project([*zip(moment.residual(lam=()), strict=True)], moment.loops[0])[0]

    def _project(self, columns: Sequence[Numbers], J: Rows) -> Rows:
        """Return Z^T x for the columns x of a matrix that is given by rows."""
        context, n = self.moment.context, self.moment.size
        dependent = [i for i in range(n) if i not in self.independent]
        block = context.matrix([[row[i] for row in J] for i in dependent]) if dependent else None
        found = []
        for x in zip(*columns, strict=True):
            lam = list(context.lu_solve(block, context.matrix([x[i] for i in dependent]))) if dependent else []
            found.append([x[i] - _dot([row[i] for row in J], lam) for i in self.independent])
        return found

    @cached_property
    def terms(self) -> tuple[Rows, list[Any]]:
        """Compute M and c of the independent coordinates."""
        f = len(self.independent)
        drift = self.complete(ydd=[0] * f)
        none = [0] * len(self.moment.loops[0])
        Z = [self._follow(drift.loops[0], none, _unit(f, k)) for k in range(f)]
        products = [[_dot(row, column) for column in Z] for row in drift.M]
        found = drift.equations.evaluate(drift.state)["Phi"]
        columns = self._project(products, drift.loops[0])
        return [list(row) for row in zip(*columns, strict=True)], self._project([[x] for x in found], drift.loops[0])[0]

    @cached_property
    def solution(self) -> dict[str, list[Any]]:
        """Solve for ydd, and for tau where joints are driven."""
        return self._pick(self.complete().solution)

    def differentiate(self, name: str) -> dict[str, Rows]:
        """Differentiate the solution by an input: for each of ydd and tau, a row for each entry of the input.

        Velocities depend on q and yd, and on parameters: the rest follows from their change.
        """
        at = self.complete()
        moved = self.moment.vary(lambda **changes: list(self.complete(**changes).state["qd"]), name)
        own = at.vary(at.balance, name, **at.solution) if name in at.state and name != "yd" else None
        by_qd = at.vary(at.balance, "qd", **at.solution)
        rows = []
        for k, change in enumerate(moved):
            along = [_dot(change, column) for column in zip(*by_qd, strict=True)]
            rows.append(along if own is None else [a + b for a, b in zip(along, own[k], strict=True)])
        found = at.divide(rows)
        return self._pick_rows(found)

    def slopes(self, name: str) -> Rows:
        """Differentiate the residual by an input: a row for each entry of the input."""
        return self.moment.vary(self.residual, name)

    def _pick(self, found: Mapping[str, list[Any]]) -> dict[str, list[Any]]:
        own = {"ydd": [found["qdd"][i] for i in self.independent]}
        return own | ({"tau": found["tau"]} if "tau" in found else {})

    def _pick_rows(self, found: Mapping[str, Rows]) -> dict[str, Rows]:
        rows = [self._pick({name: own[k] for name, own in found.items()}) for k in range(len(found["qdd"]))]
        return {name: [row[name] for row in rows] for name in (rows[0] if rows else ())}


def _unit(n: int, i: int) -> list[int]:
    return [int(k == i) for k in range(n)]


def _dot(a: Numbers, b: Numbers) -> Any:
    return sum((x * y for x, y in zip(a, b, strict=True)), 0)
