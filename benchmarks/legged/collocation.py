"""Direct collocation of a motion in phases, as a user of CasADi writes it: one MX graph, solved by IPOPT with MUMPS.

Each phase has a mesh of equal intervals, Radau points, states at mesh and collocation points, accelerations and contact
forces at collocation points, and inputs that are constant over an interval. At every point hold

    sum_r D_jr q_r = h qd_j,    sum_r D_jr qd_r = h qdd_j,    Phi(q_j, qd_j, qdd_j, f_j) = B u,    J(q_j) qd_j = 0

where J is the Jacobian of the points p that stand on the ground; at the first point of several, p(q_d) = p(q_0)
replaces the last, between both ends of the interval. Variables and rows lie interval by interval.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmarks.legged.chains import Mechanism

Array = NDArray[np.float64]
INFINITE = float("inf")
ROUNDED = 1e-3  # N: the apex of the friction cone


@dataclass(frozen=True)
class Phase:
    """A phase: a mechanism, a mesh, bounds, and the points that stand."""

    mechanism: Mechanism
    actuated: Sequence[int]  # joints with an input
    intervals: int
    degree: int
    horizon: tuple[float, float, float]  # lower and upper bound, guess
    q: ArrayLike  # (n, 2) bounds
    qd: ArrayLike
    u: ArrayLike
    guess: Callable[[float], tuple[ArrayLike, ArrayLike]]  # of the part of the horizon in [0, 1]: q and qd
    feet: Sequence[str] = ()  # points that stand
    axes: Sequence[int] = (0, 1, 2)  # along which they are held; the last one is the normal
    friction: float = 0.0
    weight: float = 0.0  # of the body [N], which a guess spreads over the feet
    inputs_cost: float = 1.0  # times the integral of the squares of the inputs
    speed_cost: float = 0.0  # times the integral of the squares of the velocities of driven joints
    time_cost: float = 0.0  # times the duration
    rows: Callable[[ca.MX, ca.MX], list[tuple[ca.MX, float, float]]] = lambda _q, _qd: []  # at every point


@dataclass(frozen=True)
class Ends:
    """The ends of a phase in the graph."""

    q0: ca.MX
    qd0: ca.MX
    q1: ca.MX
    qd1: ca.MX
    T: ca.MX


@dataclass
class Graph:
    """A program that grows: variables, rows, cost."""

    variables: list[ca.MX] = field(default_factory=list)
    bounds: list[tuple[Array, Array, Array]] = field(default_factory=list)  # lower, upper, guess
    rows: list[ca.MX] = field(default_factory=list)
    limits: list[tuple[Array, Array]] = field(default_factory=list)
    cost: ca.MX = field(default_factory=lambda: ca.MX(0))

    def add(self, lower: ArrayLike, upper: ArrayLike, guess: ArrayLike) -> ca.MX:
        """Add variables."""
        low, high, first = (np.asarray(x, float).ravel() for x in np.broadcast_arrays(lower, upper, guess))
        variable = ca.MX.sym("x", first.size)
        self.variables.append(variable)
        self.bounds.append((low, high, first))
        return variable

    def require(self, row: ca.MX, lower: float = 0.0, upper: float = 0.0) -> None:
        """Add rows that stay within a range."""
        self.rows.append(row)
        self.limits.append((np.full(row.numel(), lower), np.full(row.numel(), upper)))

    def append(self, phase: Phase) -> Ends:
        """Add a phase."""
        low, high, first = phase.horizon
        T = ca.MX(first) if low == high else self.add(low, high, first)
        h = T / phase.intervals
        tau, derivative, quadrature = _points(phase.degree)
        q, qd, u = (np.asarray(x, float).reshape(-1, 2) for x in (phase.q, phase.qd, phase.u))
        held = len(phase.feet) * len(phase.axes)
        n = phase.mechanism.n

        def state(s: float) -> ca.MX:
            guess = np.concatenate([np.asarray(x, float).ravel() for x in phase.guess(s)])
            return self.add(np.concatenate((q[:, 0], qd[:, 0])), np.concatenate((q[:, 1], qd[:, 1])), guess)

        normal = np.tile([axis == phase.axes[-1] for axis in phase.axes], len(phase.feet))
        weights = np.where(normal, phase.weight / max(1, len(phase.feet)), 0.0)
        start = now = state(0.0)
        for k in range(phase.intervals):
            inputs = self.add(u[:, 0], u[:, 1], 0.0)
            states = [now, *(state((k + t) / phase.intervals) for t in tau)]
            acceleration = [self.add(np.full(n, -INFINITE), INFINITE, 0.0) for _ in tau]
            force = [self.add(np.where(normal, 0.0, -INFINITE), INFINITE, weights) for _ in tau if held]
            for j in range(1, phase.degree + 1):
                x, a = states[j], acceleration[j - 1]
                slope = sum((derivative[r, j] * states[r] for r in range(phase.degree + 1)), ca.MX(0))
                self.require(slope - h * ca.vertcat(x[n:], a))
                f = force[j - 1] if held else ca.MX(0, 1)
                self._move(phase, x[:n], x[n:], a, f, inputs)
                if held:
                    self._hold(phase, states, j)
                if phase.speed_cost:
                    speeds = x[n:][list(phase.actuated)]
                    self.cost += phase.speed_cost * h * quadrature[j - 1] * ca.sumsqr(speeds)
            self.cost += phase.inputs_cost * h * ca.sumsqr(inputs)
            now = state((k + 1) / phase.intervals)
            self.require(now - states[-1])
        self.cost += phase.time_cost * T
        return Ends(start[:n], start[n:], now[:n], now[n:], T)

    def strike(
        self,
        mechanism: Mechanism,
        q: ca.MX,
        before: ca.MX,
        feet: Sequence[str],
        axes: Sequence[int],
        friction: float | None = None,
    ) -> ca.MX:
        """Add an impact in which points come to rest, and return the velocities after it."""
        jump = self.add(np.full(mechanism.n, -INFINITE), INFINITE, 0.0)
        impulse = self.add(np.full(len(feet) * len(axes), -INFINITE), INFINITE, 0.0)
        self.require(mechanism.momentum(q, jump, _spread(mechanism, feet, axes, impulse)))
        after = before + jump
        self.require(_pick(mechanism, mechanism.velocities(q, after), feet, axes))
        if friction is not None:
            self._rub(friction, impulse, len(axes))
        return after

    def solve(
        self,
        *,
        expand: bool = True,
        tolerance: float = 1e-8,
        limit: float = 1e6,
        settings: Mapping[str, Any] = MappingProxyType({}),
    ) -> Answer:
        """Solve by IPOPT with some of its options; expanded to SX, or as the MX graph stands; within a time [s]."""
        options: dict[str, Any] = {
            "ipopt.print_level": 0,
            "print_time": False,
            "ipopt.sb": "yes",
            "ipopt.max_iter": 1000,
        }
        program: dict[str, Any] = {"x": ca.vertcat(*self.variables), "f": self.cost, "g": ca.vertcat(*self.rows)}
        begin = time.process_time()
        solver = ca.nlpsol(
            "solver",
            "ipopt",
            program,
            options
            | {f"ipopt.{name}": value for name, value in settings.items()}
            | {"expand": expand, "ipopt.tol": tolerance, "ipopt.max_cpu_time": limit},
        )
        built = time.process_time() - begin
        lower, upper, guess = (np.concatenate(x) for x in zip(*self.bounds, strict=True))
        low, high = (np.concatenate(x) for x in zip(*self.limits, strict=True))
        begin = time.process_time()
        found = solver(x0=guess, lbx=lower, ubx=upper, lbg=low, ubg=high)
        seconds = time.process_time() - begin
        stats = solver.stats()
        x = np.array(found["x"]).ravel()
        return Answer(
            stats["return_status"], float(found["f"]), stats["iter_count"], seconds, built, x, program["x"], low.size
        )

    def _move(self, phase: Phase, q: ca.MX, qd: ca.MX, qdd: ca.MX, force: ca.MX, inputs: ca.MX) -> None:
        """Add the equations of motion and the friction at a point."""
        mechanism = phase.mechanism
        spread = _spread(mechanism, phase.feet, phase.axes, force)
        drive = ca.MX(mechanism.n, 1)
        drive[list(phase.actuated)] = inputs
        self.require(mechanism.residual(q, qd, qdd, spread) - drive)
        if phase.feet:
            self._rub(phase.friction, force, len(phase.axes))
        for row, lower, upper in phase.rows(q, qd):
            self.require(row, lower, upper)

    def _hold(self, phase: Phase, states: Sequence[ca.MX], j: int) -> None:
        """Hold feet at point j: by their velocities, or over the interval by their places at its ends."""
        mechanism, n = phase.mechanism, phase.mechanism.n
        moved = mechanism.velocities(states[j][:n], states[j][n:])
        if j == 1 < phase.degree:
            moved = mechanism.positions(states[-1][:n]) - mechanism.positions(states[0][:n])
        self.require(_pick(mechanism, moved, phase.feet, phase.axes))

    def _rub(self, friction: float, force: ca.MX, count: int) -> None:
        """Limit forces across to the friction: a cone with a rounded apex, in the plane two straight lines."""
        for k in range(force.numel() // count):
            *across, normal = ca.vertsplit(force[k * count : (k + 1) * count])
            if len(across) == 1:
                self.require(ca.vertcat(friction * normal - across[0], friction * normal + across[0]), 0, INFINITE)
            else:
                rounded = ca.sqrt(ca.sumsqr(ca.vertcat(*across)) + ROUNDED**2)
                self.require(friction * normal + ROUNDED - rounded, 0, INFINITE)


@dataclass(frozen=True)
class Answer:
    """The end of a solve."""

    status: str
    cost: float
    iterations: int
    seconds: float  # of the processor, of the solve
    building: float  # of the processor, of derivatives
    x: Array
    variables: ca.MX
    rows: int

    def value(self, expression: ca.MX) -> Array:
        """Evaluate an expression at the solution."""
        return np.array(ca.Function("value", [self.variables], [expression])(self.x)).ravel()


def _points(degree: int) -> tuple[Array, Array, Array]:
    """Return Radau's points, the derivatives of Lagrange's polynomials at them, and the weights of the quadrature."""
    tau = np.array([0.0, *ca.collocation_points(degree, "radau")])
    derivative = np.zeros((degree + 1, degree + 1))
    for r in range(degree + 1):
        others = np.delete(tau, r)
        derivative[r] = np.polyval(np.polyder(np.poly(others) / np.prod(tau[r] - others)), tau)
    powers = np.vander(tau[1:], increasing=True).T
    weights = np.linalg.solve(powers, 1 / np.arange(1, degree + 1))
    return tau[1:].astype(float), derivative, weights.astype(float)


def _spread(mechanism: Mechanism, feet: Sequence[str], axes: Sequence[int], force: ca.MX) -> ca.MX:
    """Place forces along axes of some points in the matrix of forces on all."""
    spread = ca.MX(3, len(mechanism.points))
    for k, foot in enumerate(feet):
        for i, axis in enumerate(axes):
            spread[axis, mechanism.points.index(foot)] = force[k * len(axes) + i]
    return spread


def _pick(mechanism: Mechanism, values: ca.MX, feet: Sequence[str], axes: Sequence[int]) -> ca.MX:
    """Pick components of some points out of a matrix with a column for each."""
    return ca.vertcat(*(values[axis, mechanism.points.index(foot)] for foot in feet for axis in axes))
