"""Random convex quadratic programs in stages: `python -m benchmarks.ocp.quadratics`; csrc/stages beside IPOPT.

The kinds are from the test sets of OSQP (Stellato, Banjac, Goulart, Bemporad, Boyd, Mathematical Programming
Computation 12 (2020), appendix A) and of Maros and Meszaros (Optimization Methods and Software 11 (1999)),
with sums that run over stages as states: 200 programs, of ten kinds in turn. A convex program has one optimal cost, so
an answer whose cost differs from IPOPT's is wrong. Where IPOPT has none, violation and the gap of duality judge.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from tests.csrc.stages import INFINITE, Library, Quadratic, Solver, compile_solver

Array = NDArray[np.float64]
Rng = np.random.Generator

SAME = 1e-6  # relative difference of costs within which two answers are one
RELAXED = {"ipopt.bound_relax_factor": 1e-8}  # IPOPT's default, which programs without an interior need


@dataclass(frozen=True)
class Stage:
    """A stage: half w'Hw + q'w of w = (x, v), the next x = Fw + b, Ew + e = 0, ranges of Gw and of w."""

    nx: int
    H: Array
    q: Array
    F: Array
    b: Array
    E: Array
    e: Array
    G: Array
    rows: tuple[Array, Array]
    bounds: tuple[Array, Array]


def make_stage(nx: int, nv: int, after: int, **given: Any) -> Stage:
    """Make a stage; what is not given is zero, or without rows and bounds."""
    n = nx + nv

    def matrix(name: str, rows: int) -> Array:
        return np.atleast_2d(np.asarray(given.get(name, np.zeros((rows, n))), dtype=np.float64))

    E, G = matrix("E", 0).reshape(-1, n), matrix("G", 0).reshape(-1, n)
    free = np.full(n, INFINITE)
    return Stage(
        nx,
        matrix("H", n),
        np.asarray(given.get("q", np.zeros(n)), dtype=np.float64),
        matrix("F", after).reshape(after, n),
        np.asarray(given.get("b", np.zeros(after)), dtype=np.float64),
        E,
        np.asarray(given.get("e", np.zeros(len(E))), dtype=np.float64),
        G,
        given.get("rows", (np.zeros(0), np.zeros(0))),
        given.get("bounds", (-free, free)),
    )


def join(stages: Sequence[Stage]) -> Quadratic:
    """Put stages together, with a guess of zeros."""
    bounds, rows = [s.bounds for s in stages], [s.rows for s in stages]
    return Quadratic(
        [(s.nx, len(s.q) - s.nx, len(s.E), len(s.G)) for s in stages],
        [s.H for s in stages],
        [s.q for s in stages],
        [s.F for s in stages],
        [s.b for s in stages],
        [s.E for s in stages],
        [s.e for s in stages],
        [s.G for s in stages],
        lower=np.concatenate([lower for lower, _ in bounds]),
        upper=np.concatenate([upper for _, upper in bounds]),
        least=np.concatenate([least for least, _ in rows]),
        most=np.concatenate([most for _, most in rows]),
        guess=np.zeros(sum(len(s.q) for s in stages)),
    )


def _spread(rng: Rng, rows: int, columns: int, share: float = 0.5) -> Array:
    return np.asarray(rng.standard_normal((rows, columns)) * (rng.random((rows, columns)) < share))


def _free(*parts: Array | float | int) -> Array:
    """Join parts of a bound; a whole number stands for that many without one."""
    return np.concatenate([np.full(p, INFINITE) if isinstance(p, int) else np.atleast_1d(p) for p in parts])


# --- kinds ----------------------------------------------------------------------------------------------------------


def control(rng: Rng) -> Quadratic:
    """OSQP's A.3: a linear system, bounds on states and inputs, a final cost."""
    nx, nv = int(rng.integers(3, 9)), int(rng.integers(1, 5))
    A = np.eye(nx) + 0.1 * rng.standard_normal((nx, nx))
    A /= max(1.0, float(np.abs(np.linalg.eigvals(A)).max()))
    B = rng.standard_normal((nx, nv))
    Q = np.diag(10 * rng.random(nx) * (rng.random(nx) < 0.7))
    u, wide = rng.uniform(0.1, 0.5), 1 + rng.random(nx)
    H = np.block([[Q, np.zeros((nx, nv))], [np.zeros((nv, nx)), 0.1 * np.eye(nv)]])
    start, high = rng.uniform(-0.5, 0.5, nx) * wide, np.concatenate([wide, np.full(nv, u)])
    middle = {"H": H, "F": np.hstack([A, B])}
    first = (np.concatenate([start, -high[nx:]]), np.concatenate([start, high[nx:]]))
    stages = [make_stage(nx, nv, nx, **middle, bounds=first)]
    stages += [make_stage(nx, nv, nx, **middle, bounds=(-high, high)) for _ in range(9)]
    return join([*stages, make_stage(nx, 0, 0, H=10 * Q + np.eye(nx), bounds=(-wide, wide))])


def portfolio(rng: Rng) -> Quadratic:
    """OSQP's A.4: shares >= 0 that sum up to 1; stages add assets to factors and to the sum."""
    factors, assets, groups = int(rng.integers(2, 6)), int(rng.integers(3, 8)), int(rng.integers(3, 9))
    nx, stages = factors + 1, []
    for k in range(groups):
        D, mu = np.sqrt(factors) * rng.random(assets), rng.standard_normal(assets)
        F = np.hstack([np.eye(nx), np.vstack([_spread(rng, factors, assets), np.ones(assets)])])
        low, high = _free(nx, np.zeros(assets)), _free(nx, assets)
        low[:nx] *= -1
        if k == 0:
            low[:nx] = high[:nx] = 0.0
        H = np.diag(np.concatenate([np.zeros(nx), 2 * D]))
        stages.append(make_stage(nx, assets, nx, H=H, q=np.concatenate([np.zeros(nx), -mu]), F=F, bounds=(low, high)))
    last = np.diag([*[2.0] * factors, 0.0])
    return join([*stages, make_stage(nx, 0, 0, H=last, E=np.eye(nx)[-1:], e=[-1.0])])


def lasso(rng: Rng) -> Quadratic:
    """OSQP's A.5: least squares with a price of absolute values, by t >= |x|; stages add columns to the residual."""
    rows, columns = int(rng.integers(4, 10)), int(rng.integers(5, 20))
    A, b = _spread(rng, rows, columns), rng.standard_normal(rows)
    price = float(np.abs(A.T @ b).max()) / 5
    stages = []
    for k in range(columns):
        F = np.hstack([np.eye(rows), A[:, k : k + 1], np.zeros((rows, 1))])
        G = np.hstack([np.zeros((2, rows)), [[-1.0, 1.0], [1.0, 1.0]]])
        fixed = np.concatenate([-b, [INFINITE] * 2]) if k == 0 else np.full(rows + 2, INFINITE)
        low = np.where(fixed == INFINITE, -INFINITE, fixed)
        q = np.concatenate([np.zeros(rows + 1), [price]])
        stages.append(
            make_stage(rows, 2, rows, q=q, F=F, G=G, rows=(np.zeros(2), np.full(2, INFINITE)), bounds=(low, fixed))
        )
    return join([*stages, make_stage(rows, 0, 0, H=2 * np.eye(rows))])


def huber(rng: Rng) -> Quadratic:
    """OSQP's A.6: robust regression; the coefficients are states, each stage is a row with u and r, s >= 0."""
    n, rows = int(rng.integers(2, 6)), int(rng.integers(8, 25))
    A, truth = _spread(rng, rows, n, 0.8), rng.standard_normal(n)
    b = A @ truth + np.where(rng.random(rows) < 0.9, rng.standard_normal(rows) / 4, rng.uniform(0, 10, rows))
    high = np.full(n + 3, INFINITE)
    low = np.concatenate([-high[: n + 1], np.zeros(2)])
    H, q = np.diag([*[0.0] * n, 2.0, 0.0, 0.0]), np.array([*[0.0] * (n + 1), 2.0, 2.0])
    F = np.hstack([np.eye(n), np.zeros((n, 3))])
    stages = [
        make_stage(
            n, 3, n, H=H, q=q, F=F, E=np.concatenate([a, [-1.0, -1.0, 1.0]])[None], e=[-value], bounds=(low, high)
        )
        for a, value in zip(A, b, strict=True)
    ]
    return join([*stages, make_stage(n, 0, 0)])


def vectors(rng: Rng) -> Quadratic:
    """OSQP's A.7: a support vector machine; the plane is a state, each stage is a point with its excess t >= 0."""
    n, points = int(rng.integers(2, 6)), int(rng.integers(8, 25))
    F = np.hstack([np.eye(n), np.zeros((n, 1))])
    low, high = np.concatenate([np.full(n, -INFINITE), [0.0]]), np.full(n + 1, INFINITE)
    stages = []
    for k in range(points):
        side = 1.0 if k % 2 else -1.0
        a = rng.standard_normal(n) / np.sqrt(n) + side / n
        G = np.concatenate([side * a, [1.0]])[None]
        rows = (np.array([1.0]), np.array([INFINITE]))
        q = np.concatenate([np.zeros(n), [1.0]])
        stages.append(make_stage(n, 1, n, q=q, F=F, G=G, rows=rows, bounds=(low, high)))
    return join([*stages, make_stage(n, 0, 0, H=np.eye(n))])


def smoothing(rng: Rng) -> Quadratic:
    """LISWET and YAO: the nearest sequence with differences of second or third order >= 0; many bind at once."""
    order, size = int(rng.integers(2, 4)), int(rng.integers(15, 60))
    shift = np.diag(np.ones(order - 1), 1) if order > 1 else np.zeros((1, 1))
    F = np.hstack([shift, np.eye(order)[:, -1:]])  # the last values; the new one is v
    signs = np.array([math.comb(order, i) * (-1.0) ** (order - i) for i in range(order + 1)])
    grid = np.linspace(0, 1, size)
    given = np.sqrt(grid) + 0.1 * np.sin(np.arange(size)) if rng.random() < 0.5 else rng.standard_normal(size)
    stages = []
    for k in range(size):
        bounded = k >= order
        low, high = np.full(order + 1, -INFINITE), np.full(order + 1, INFINITE)
        if k == 0:
            low[:order] = high[:order] = 0.0
        rows = (np.zeros(1), np.full(1, INFINITE)) if bounded else (np.zeros(0), np.zeros(0))
        H, q = np.diag([*[0.0] * order, 1.0]), np.array([*[0.0] * order, -given[k]])
        stages.append(
            make_stage(order, 1, order, H=H, q=q, F=F, G=signs[None][:bounded], rows=rows, bounds=(low, high))
        )
    return join([*stages, make_stage(order, 0, 0)])


def powell(rng: Rng) -> Quadratic:
    """POWELL20: least squares, neighbours differ by growing amounts; numbers are large, and most rows bind."""
    size = int(rng.integers(10, 60))
    stages = []
    for k in range(size):
        # w = (value before, value); the row's bound grows, its side alternates
        side = 1.0 if k % 2 else -1.0
        low, high = np.full(2, -INFINITE), np.full(2, INFINITE)
        if k == 0:
            low[0] = high[0] = 0.0
        bound = k - 0.5 if k else -1.0
        rows = (np.array([bound]), np.array([INFINITE]))
        stages.append(
            make_stage(1, 1, 1, H=np.diag([0.0, 1.0]), F=[[0.0, 1.0]], G=[[-side, side]], rows=rows, bounds=(low, high))
        )
    return join([*stages, make_stage(1, 0, 0)])


def rails(rng: Rng) -> Quadratic:
    """Masses from rest to rest, exactly discretised; rails end where the motion ends, and nothing moves backwards."""
    masses, steps = int(rng.integers(1, 4)), int(rng.integers(8, 40))
    h, n = 2.0 / steps, masses
    A = np.block([[np.eye(n), h * np.eye(n)], [np.zeros((n, n)), np.eye(n)]])
    B = np.vstack([h * h / 2 * np.eye(n), h * np.eye(n)])
    goal = rng.uniform(0.3, 2.5, n)
    forward = np.where(rng.random(n) < 0.6, 0.0, -INFINITE)
    below = np.where(rng.random(n) < 0.5, 0.0, -rng.uniform(0, 1, n))
    above = np.where(rng.random(n) < 0.7, goal, INFINITE)
    low, high = np.concatenate([below, forward, np.full(n, -INFINITE)]), _free(above, n, n)
    H = np.diag([*[0.0] * (2 * n), *[2 * h] * n])
    weights = rng.integers(1, 4, n).astype(float)
    G = np.concatenate([weights, np.zeros(2 * n)])[None]
    rows = (np.array([-INFINITE]), np.array([weights @ goal]))
    start, end = np.zeros(2 * n), np.concatenate([goal, np.zeros(n)])
    stages = []
    for k in range(steps):
        own = (low.copy(), high.copy())
        if k == 0:
            own[0][: 2 * n] = own[1][: 2 * n] = start
        stages.append(make_stage(2 * n, n, 2 * n, H=H, F=np.hstack([A, B]), G=G, rows=rows, bounds=own))
    return join([*stages, make_stage(2 * n, 0, 0, E=np.eye(2 * n), e=-end, G=G[:, : 2 * n], rows=rows)])


def simplex(rng: Rng) -> Quadratic:
    """DUAL and PRIMAL: a dense form over shares whose sum is 1, by stages, and a sum with limits that are met."""
    n, count = int(rng.integers(2, 6)), int(rng.integers(3, 12))
    stages = []
    for k in range(count):
        root = rng.standard_normal((n, n))
        H = np.block([[np.zeros((1, 1)), np.zeros((1, n))], [np.zeros((n, 1)), root.T @ root]])
        low, high = np.concatenate([[0.0], np.zeros(n)]), np.concatenate([[1.0], np.full(n, 0.625)])
        if k == 0:
            high[0] = 0.0
        F = np.concatenate([[1.0], np.ones(n)])[None]
        stages.append(make_stage(1, n, 1, H=H, F=F, bounds=(low, high)))
    return join([*stages, make_stage(1, 0, 0, bounds=(np.ones(1), np.ones(1)))])


def repeated(rng: Rng) -> Quadratic:
    """Rows twice, equations that follow from others, fixed variables, and opposite inequalities."""
    nx, nv, count = int(rng.integers(2, 5)), int(rng.integers(2, 5)), int(rng.integers(4, 15))
    point = [rng.standard_normal(nx + nv) for _ in range(count + 1)]
    stages = []
    for k in range(count):
        w, after = point[k], point[k + 1][:nx]
        F = rng.standard_normal((nx, nx + nv)) / 2
        G = rng.standard_normal((2, nx + nv))
        values = G @ w
        rows = (np.array([values[0], -INFINITE]), np.array([INFINITE, values[1]]))
        if rng.random() < 0.6:  # the same row again, and its multiple
            G = np.vstack([G, G[0], 2 * G[1]])
            rows = (np.append(rows[0], [values[0], -INFINITE]), np.append(rows[1], [INFINITE, 2 * values[1]]))
        if rng.random() < 0.5:  # the other side: no interior
            G = np.vstack([G, G[0]])
            rows = (np.append(rows[0], -INFINITE), np.append(rows[1], values[0]))
        E = rng.standard_normal((1, nx + nv))
        E = np.vstack([E, 3 * E]) if rng.random() < 0.5 else E
        low, high = np.full(nx + nv, -INFINITE), np.full(nx + nv, INFINITE)
        chosen = rng.random(nx + nv) < 0.3
        low[chosen] = w[chosen]
        fixed = rng.random(nx + nv) < 0.15
        low[fixed] = high[fixed] = w[fixed]
        if k == 0:
            low[:nx] = high[:nx] = w[:nx]
        root = rng.standard_normal((nx + nv, nx + nv))
        q = rng.standard_normal(nx + nv)
        stages.append(
            make_stage(
                nx,
                nv,
                nx,
                H=root.T @ root,
                q=q,
                F=F,
                b=after - F @ w,
                E=E,
                e=-E @ w,
                G=G,
                rows=rows,
                bounds=(low, high),
            )
        )
    return join([*stages, make_stage(nx, 0, 0, H=np.eye(nx))])


KINDS: Mapping[str, Callable[[Rng], Quadratic]] = {
    "control": control,
    "portfolio": portfolio,
    "lasso": lasso,
    "huber": huber,
    "vectors": vectors,
    "smoothing": smoothing,
    "powell": powell,
    "rails": rails,
    "simplex": simplex,
    "repeated": repeated,
}


def draw(number: int) -> tuple[str, Quadratic]:
    """Draw a program; kinds take turns."""
    kind = tuple(KINDS)[number % len(KINDS)]
    return kind, KINDS[kind](np.random.default_rng([41, number]))


# --- both solvers ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Result:
    """The answers to one program."""

    number: int
    kind: str
    status: str
    iterations: int
    cost: float
    violation: float
    gap: float  # of duality, relative to the cost
    peer_status: str
    peer_iterations: int
    peer_cost: float

    @property
    def is_solved(self) -> bool:
        """Return whether the solver says so."""
        return self.status in ("solved", "acceptable")

    @property
    def is_peer_solved(self) -> bool:
        """Return whether IPOPT says so."""
        return self.peer_status in ("Solve_Succeeded", "Solved_To_Acceptable_Level")

    @property
    def is_wrong(self) -> bool:
        """Return whether an answer is not the optimum."""
        off = abs(self.cost - self.peer_cost) > SAME * max(1.0, abs(self.peer_cost))
        return self.is_solved and (off if self.is_peer_solved else self.gap > SAME or self.violation > SAME)


def solve(number: int, library: Library) -> Result:
    """Solve a program by both."""
    kind, program = draw(number)
    answer = Solver(library, program).solve(max_iter=500)
    theirs, statistics = program.ipopt()
    if statistics["return_status"] != "Solve_Succeeded":
        theirs, statistics = program.ipopt(**RELAXED)
    P, q, A, lower, upper = program.matrices
    cost = float(answer.w @ (P @ answer.w) / 2 + q @ answer.w)
    value = A @ answer.w
    violation = max(
        float(np.maximum(lower - value, value - upper).max(initial=0.0)),
        float(np.maximum(program.lower - answer.w, answer.w - program.upper).max(initial=0.0)),
    )
    gap = measure_gap(program, answer.w, answer.y, answer.below, answer.above)
    status, iterations = statistics["return_status"], int(statistics["iter_count"])
    return Result(
        number,
        kind,
        answer.status,
        int(answer.result.iterations),
        cost,
        violation,
        gap / max(1.0, abs(cost)),
        status,
        iterations,
        float(theirs["f"][0]),
    )


def measure_gap(program: Quadratic, w: Array, y: Array, below: Array, above: Array) -> float:
    """Return the cost above the dual cost: products of multipliers and distances, and the rest of stationarity."""
    P, q, A, lower, upper = program.matrices
    gradient = P @ w + q + A.T @ y - below + above
    value, down, up = A @ w, np.maximum(-y, 0.0), np.maximum(y, 0.0)
    pairs = ((w - program.lower, below), (program.upper - w, above), (value - lower, down), (upper - value, up))
    found = sum(float(d[z > 0] @ z[z > 0]) for d, z in pairs if (z > 0).any())
    return abs(found) + float(np.abs(gradient) @ np.abs(w))


# --- the page -------------------------------------------------------------------------------------------------------


def summarise(results: Sequence[Result]) -> tuple[str, ...]:
    """Return the cells of a line over some programs."""
    same = [r for r in results if r.is_solved and r.is_peer_solved and not r.is_wrong]
    ratios = [math.log(max(r.iterations, 1) / max(r.peer_iterations, 1)) for r in same]
    return (
        str(len(results)),
        f"{sum(r.is_solved for r in results)}, {sum(r.is_peer_solved for r in results)}",
        str(sum(r.is_wrong for r in results)),
        f"{sum(r.iterations for r in same)}, {sum(r.peer_iterations for r in same)}",
        f"{math.exp(float(np.mean(ratios))):.2f}" if ratios else "",
        f"{max((r.gap for r in same), default=math.nan):.0e}",
    )


def write_page(results: Sequence[Result]) -> str:
    """Write the comparison as Markdown: by kind, then each program with a wrong answer or none."""
    lines = [
        "# Quadratic programs in stages",
        "",
        "`python -m benchmarks.ocp.quadratics` wrote this page. Random convex programs in the style of the test sets",
        "of OSQP and of Maros and Meszaros are solved by `csrc/stages` and by IPOPT, from zeros. Of two numbers in a",
        "cell, the second one is IPOPT's. A convex program has one optimal cost: an answer that differs from it by",
        f"{SAME:g} is wrong.",
        "",
        "| kind | programs | solved | wrong | iterations | mean ratio | largest gap of duality |",
        "|---|---|---|---|---|---|---|",
    ]
    for kind in KINDS:
        if own := [r for r in results if r.kind == kind]:
            lines.append(f"| {kind} | {' | '.join(summarise(own))} |")
    lines.append(f"| **all** | {' | '.join(summarise(results))} |")
    if listed := [r for r in results if r.is_wrong or not (r.is_solved and r.is_peer_solved)]:
        lines += ["", "| number | kind | `mbs` | cost | IPOPT | cost |", "|---|---|---|---|---|---|"]
        lines += [
            f"| {r.number} | {r.kind} | {'wrong, ' * r.is_wrong}{r.status}, {r.iterations} | {r.cost:.9g} "
            f"| {r.peer_status}, {r.peer_iterations} | {r.peer_cost:.9g} |"
            for r in listed
        ]
    return "\n".join(lines) + "\n"


def read_arguments(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.ocp.quadratics", description=__doc__)
    parser.add_argument("--first", type=int, default=0, help="number of the first program; 0")
    parser.add_argument("--programs", type=int, default=200, help="how many; 200")
    parser.add_argument("--out", type=Path, default=Path("build/bench-ends"), help="folder of the results")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> None:
    """Solve all programs, and write the page."""
    options, console, results = read_arguments(arguments), Console(), list[Result]()
    options.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        library = Library(compile_solver(Path(folder)))
        for number in range(options.first, options.first + options.programs):
            results.append(solve(number, library))
            if results[-1].is_wrong or not results[-1].is_solved:
                console.print(f"{number}: {results[-1]}", highlight=False, markup=False)
    (options.out / "quadratics.jsonl").write_text("".join(json.dumps(asdict(r)) + "\n" for r in results), "utf-8")
    page = write_page(results)
    (options.out / "quadratics.md").write_text(page, "utf-8")
    console.print(page, markup=False)


if __name__ == "__main__":
    main()
