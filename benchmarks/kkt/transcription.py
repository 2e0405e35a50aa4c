"""Control problems and their transcriptions, in plain CasADi: Problem, Scheme -> a nonlinear program.

A problem is

    minimise  M(x(T), p) + int_0^T L(x, u, p, t) dt + sum over measurements of |x(t_j) - z_j|^2
    such that x' = f(x, u, p, t),  c_lower <= c(x, u, p, t) <= c_upper,  e(x(T), p) = 0,  bounds.

A free horizon T is the first of the parameters p. Schemes: Betts, "Practical Methods for Optimal Control and Estimation
Using Nonlinear Programming" (2010), for the trapezoid and Hermite and Simpson's rule; Biegler, "Nonlinear Programming"
(2010), for collocation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Bounds = tuple[float, float]
Expression = Callable[[ca.SX, ca.SX, ca.SX, ca.SX], ca.SX]  # of x, u, p, t
Terminal = Callable[[ca.SX, ca.SX], ca.SX]  # of x, p
Path = Callable[[float], Sequence[float]]  # of t / T

FREE = (-np.inf, np.inf)
POSITIVE = (0.0, np.inf)


def nothing(*_: ca.SX) -> ca.SX:
    """Return no rows."""
    return ca.SX(0, 1)


def zero(*_: ca.SX) -> ca.SX:
    """Return no cost."""
    return ca.SX(0)


@dataclass(frozen=True)
class Measurements:
    """Measured states: the rows of `values` at `times`."""

    times: tuple[float, ...]
    values: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class Problem:
    """A problem of optimal control or estimation; a start or an end of None is free."""

    name: str
    source: str
    rates: Expression
    x: tuple[Bounds, ...]
    u: tuple[Bounds, ...]
    start: tuple[float | None, ...]
    end: tuple[float | None, ...]
    horizon: float | None  # None: it is p[0]
    guess_x: Path
    guess_u: Path = lambda _: ()
    p: tuple[Bounds, ...] = ()
    guess_p: tuple[float, ...] = ()
    running: Expression = zero
    final: Terminal = zero
    path: Expression = nothing
    path_bounds: tuple[Bounds, ...] = ()
    closing: Terminal = nothing  # vanishes at the end
    measured: Measurements | None = None
    intervals: int = 200
    optimum: float | None = None  # printed by the source, or in closed form
    digits: float = 1e-3  # relative difference from the optimum that a mesh may have


@dataclass(frozen=True)
class Scheme:
    """How an interval is discretised: unknowns within it, and whether inputs belong to mesh points."""

    name: str
    inner: str  # of x and u, in their order
    has_mesh_inputs: bool
    write: Callable[[Problem, dict[str, Any]], tuple[list[ca.SX], ca.SX, list[ca.SX]]]


@dataclass(frozen=True)
class Program:
    """A nonlinear program, with its start."""

    nlp: dict[str, Any]  # x, f, g: expressions
    start: Array
    lower: Array
    upper: Array
    g_lower: Array
    g_upper: Array


def _trapezoid(problem: Problem, v: dict[str, Any]) -> tuple[list[ca.SX], ca.SX, list[ca.SX]]:
    f, h = problem.rates, v["h"]
    a, b = (v["x0"], v["u0"], v["p"], v["t"]), (v["x1"], v["u1"], v["p"], v["t"] + h)
    cost = h / 2 * (problem.running(*a) + problem.running(*b))
    return [v["x1"] - v["x0"] - h / 2 * (f(*a) + f(*b))], cost, [problem.path(*a)]


def _simpson(problem: Problem, v: dict[str, Any]) -> tuple[list[ca.SX], ca.SX, list[ca.SX]]:
    f, h, p = problem.rates, v["h"], v["p"]
    a, b = (v["x0"], v["u0"], p, v["t"]), (v["x1"], v["u1"], p, v["t"] + h)
    m = (v["x"][0], v["u"][0], p, v["t"] + h / 2)
    rows = [
        v["x"][0] - (v["x0"] + v["x1"]) / 2 - h / 8 * (f(*a) - f(*b)),
        v["x1"] - v["x0"] - h / 6 * (f(*a) + 4 * f(*m) + f(*b)),
    ]
    cost = h / 6 * (problem.running(*a) + 4 * problem.running(*m) + problem.running(*b))
    return rows, cost, [problem.path(*a), problem.path(*m)]


def collocate(family: str, degree: int, *, is_constant: bool) -> Scheme:
    """Return collocation at the points of a family, with inputs at each point, or constant ones."""
    taus = ca.collocation_points(degree, family)
    C, D, B = (c.full() for c in ca.collocation_coeff(taus))

    def write(problem: Problem, v: dict[str, Any]) -> tuple[list[ca.SX], ca.SX, list[ca.SX]]:
        h, p = v["h"], v["p"]
        nodes = [v["x0"], *v["x"]]
        inputs = v["u"] * degree if is_constant else v["u"]
        points = [(x, u, p, v["t"] + h * tau) for x, u, tau in zip(v["x"], inputs, taus, strict=True)]
        rows = [
            sum(C[r, j] * x for r, x in enumerate(nodes)) - h * problem.rates(*point) for j, point in enumerate(points)
        ]
        rows.append(sum(D[r, 0] * x for r, x in enumerate(nodes) if abs(D[r, 0]) > 1e-12) - v["x1"])
        cost = h * sum(B[j, 0] * problem.running(*point) for j, point in enumerate(points))
        return rows, cost, [problem.path(*point) for point in points]

    inner = "x" * degree + "u" * (1 if is_constant else degree)
    return Scheme(f"{family.capitalize()} {degree}" + (", constant u" if is_constant else ""), inner, False, write)


def _shoot(steps: int) -> Scheme:
    """Return multiple shooting: steps of the classical Runge-Kutta method, with constant inputs."""

    def write(problem: Problem, v: dict[str, Any]) -> tuple[list[ca.SX], ca.SX, list[ca.SX]]:
        h, p, (u,) = v["h"] / steps, v["p"], v["u"]
        x, t, cost = v["x0"], v["t"], ca.SX(0)

        def rates(x: ca.SX, t: ca.SX) -> ca.SX:
            return ca.vertcat(problem.rates(x, u, p, t), problem.running(x, u, p, t))

        n = x.numel()
        for _ in range(steps):
            k1 = rates(x, t)
            k2 = rates(x + h / 2 * k1[:n], t + h / 2)
            k3 = rates(x + h / 2 * k2[:n], t + h / 2)
            k4 = rates(x + h * k3[:n], t + h)
            step = h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            x, cost, t = x + step[:n], cost + step[n], t + h
        return [x - v["x1"]], cost, [problem.path(v["x0"], u, p, v["t"])]

    return Scheme(f"shooting, RK4 x {steps}", "u", False, write)


SCHEMES = (
    Scheme("trapezoid", "", True, _trapezoid),
    Scheme("Hermite-Simpson", "xu", True, _simpson),
    collocate("radau", 3, is_constant=False),
    collocate("legendre", 4, is_constant=True),
    _shoot(2),
)


def admits(problem: Problem, scheme: Scheme) -> bool:
    """Return whether a scheme has inputs enough for the algebraic equations of a problem, which hold at its points."""
    equations = sum(lower == upper for lower, upper in problem.path_bounds)
    return equations * max(1, scheme.inner.count("x")) <= len(problem.u) * max(1, scheme.inner.count("u"))


@dataclass
class _Layout:
    """Collects variables with bounds and starts, and constraints with bounds."""

    lower: list[float] = field(default_factory=list)
    upper: list[float] = field(default_factory=list)
    start: list[float] = field(default_factory=list)

    def add(self, bounds: Sequence[Bounds], start: Sequence[float]) -> None:
        for (lower, upper), value in zip(bounds, start, strict=True):
            self.lower.append(lower)
            self.upper.append(upper)
            self.start.append(float(np.clip(value, lower, upper)))


def make_mesh(problem: Problem, intervals: int) -> Array:
    """Return mesh points from 0 to 1; measurements are taken at mesh points."""
    if problem.measured is None:
        return np.linspace(0.0, 1.0, intervals + 1)
    knots = np.unique([0.0, *problem.measured.times]) / problem.measured.times[-1]
    counts = np.maximum(1, np.round(np.diff(knots) * intervals)).astype(int)
    parts = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(knots, knots[1:], counts, strict=False)]
    return np.append(np.concatenate(parts), 1.0)


def _write_interval(problem: Problem, scheme: Scheme) -> ca.Function:
    """Return the function of an interval: (x0, u0, x1, u1, inner, p, t, h) -> rows, cost, path."""
    n, m = len(problem.x), len(problem.u)
    mesh_inputs = m if scheme.has_mesh_inputs else 0
    sizes = {"x0": n, "u0": mesh_inputs, "x1": n, "u1": mesh_inputs}
    v: dict[str, Any] = {name: ca.SX.sym(name, size) for name, size in sizes.items()}
    inner = [(kind, ca.SX.sym(kind, n if kind == "x" else m)) for kind in scheme.inner]
    v |= {kind: [part for k, part in inner if k == kind] for kind in "xu"}
    v |= {"p": ca.SX.sym("p", len(problem.p)), "t": ca.SX.sym("t"), "h": ca.SX.sym("h")}
    rows, cost, path = scheme.write(problem, v)
    given = [v["x0"], v["u0"], v["x1"], v["u1"], ca.vertcat(*(part for _, part in inner)), v["p"], v["t"], v["h"]]
    return ca.Function("interval", given, [ca.vertcat(*rows), cost, ca.vertcat(*path)])


def transcribe(problem: Problem, scheme: Scheme, intervals: int | None = None) -> Program:
    """Write the program; the variables of an interval follow each other, then come the end and the parameters."""
    mesh = make_mesh(problem, intervals or problem.intervals)
    N, n, m = len(mesh) - 1, len(problem.x), len(problem.u)
    mesh_inputs = m if scheme.has_mesh_inputs else 0
    inner = sum(n if kind == "x" else m for kind in scheme.inner)
    column = ca.MX.sym("column", n + mesh_inputs + inner, N)
    last, p = ca.MX.sym("last", n + mesh_inputs), ca.MX.sym("p", len(problem.p))
    knots = ca.horzcat(column[: n + mesh_inputs, :], last)
    T = p[0] if problem.horizon is None else ca.MX(problem.horizon)
    left, right = knots[:, :-1], knots[:, 1:]
    call = _write_interval(problem, scheme).map(N)
    rows, cost, path = call(
        left[:n, :],
        left[n:, :],
        right[:n, :],
        right[n:, :],
        column[n + mesh_inputs :, :],
        ca.repmat(p, 1, N),
        T * ca.DM(mesh[:-1]).T,
        T * ca.DM(np.diff(mesh)).T,
    )
    end_x, end_p = ca.SX.sym("x", n), ca.SX.sym("p", len(problem.p))
    closing = ca.Function("end", [end_x, end_p], [problem.final(end_x, end_p), problem.closing(end_x, end_p)])
    final, conditions = closing(last[:n], p)
    objective = ca.sum2(cost) + final + _write_misfit(problem, mesh, knots[:n, :])
    constraints = [ca.vec(ca.vertcat(rows, path)), conditions]
    repeats = path.size1() // max(1, len(problem.path_bounds))
    bounds = [*[(0.0, 0.0)] * rows.size1(), *problem.path_bounds * repeats] * N
    bounds += [(0.0, 0.0)] * conditions.numel()
    layout = _lay_out(problem, scheme, mesh)
    nlp = {"x": ca.vertcat(ca.vec(column), last, p), "f": objective, "g": ca.vertcat(*constraints)}
    g_lower, g_upper = np.array(bounds).reshape(-1, 2).T
    return Program(nlp, np.array(layout.start), np.array(layout.lower), np.array(layout.upper), g_lower, g_upper)


def _write_misfit(problem: Problem, mesh: Array, states: ca.MX) -> ca.MX:
    """Return the sum of squares of the differences from measurements."""
    if problem.measured is None:
        return ca.MX(0)
    times = np.array(problem.measured.times)
    at = [int(np.abs(mesh - t).argmin()) for t in times / times[-1]]
    return ca.sumsqr(states[:, at] - ca.DM(problem.measured.values).T)


def _lay_out(problem: Problem, scheme: Scheme, mesh: Array) -> _Layout:
    """List bounds and starts of the variables."""
    layout = _Layout()
    N = len(mesh) - 1

    def fix(bounds: Sequence[Bounds], values: Sequence[float | None]) -> list[Bounds]:
        return [b if v is None else (v, v) for b, v in zip(bounds, values, strict=True)]

    for k, s in enumerate(mesh):
        ends = problem.start if k == 0 else problem.end if k == N else (None,) * len(problem.x)
        layout.add(fix(problem.x, ends), problem.guess_x(s))
        if scheme.has_mesh_inputs:
            layout.add(problem.u, problem.guess_u(s))
        for kind in scheme.inner if k < N else "":
            middle = (s + mesh[k + 1]) / 2 if k < N else s
            if kind == "x":
                layout.add(problem.x, problem.guess_x(middle))
            else:
                layout.add(problem.u, problem.guess_u(middle))
    layout.add(problem.p, problem.guess_p)
    return layout
