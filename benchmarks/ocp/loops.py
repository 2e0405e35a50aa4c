"""Closed loops: `python -m benchmarks.ocp.loops`; our solves beside the same mesh in plain CasADi.

The peer writes the form with multipliers, as a user of CasADi does: the residual of the tree is a short recursion in
SX, loops are written by hand, their Jacobian is CasADi's. At each point

    q' = qd + J' mu,    qd' = z,    Phi(q, qd, z, u) = J' lam,    h(q) = 0,    J qd = 0

All are solved from the same guess, in turn. The quickest of several rounds counts, and the median stands beside it. Our
solves are by IPOPT, as the peer's, and by the project's own method (`by stages`). IPOPT relaxes no bounds.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from rich import box
from rich.console import Console
from rich.table import Table

from benchmarks.compilation import describe_machine, find_cache
from benchmarks.newton_euler import write_functions
from benchmarks.ocp.peer import TUNED, Effort, Settings, Shelf, compile_solver, list_options, list_settings
from benchmarks.ocp.rows import OURS, STAGES
from benchmarks.study import DisagreementError
from mbsgen.model.tree import Tree
from mbsgen.pipeline import read_tree
from mbsrun.closure import Closure
from mbsrun.external import load_on_demand
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.guessing.guess import make_guess
from mbsrun.ocp.problem.driving import find_point_forces
from mbsrun.ocp.problem.problem import Loops, Problem
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.solve import Solver
from mbsrun.ocp.statement.statement import read_problem

Array = NDArray[np.float64]
MODELS = Path(__file__).parents[2] / "models"
EXACT = {"bound_relax_factor": 0.0}  # IPOPT would relax bounds, and find the optimum of another problem
COLUMNS = ("way", "iterations", "evaluation [ms]", "algebra [ms]", "solve, CPU [ms]", "median", "ratio", "optimum")
SAME = 1e-6  # relative difference of costs within which two optima are one


@dataclass(frozen=True)
class Mechanism:
    """A mechanism and its task, written by hand for the peer."""

    problem: str  # the file
    model: str
    close: Callable[[ca.SX], ca.SX]  # h(q)
    path: Callable[[ca.SX], ca.SX]  # is at least 0 along the motion
    end: Callable[[ca.SX], ca.SX]  # vanishes at the end
    independent: tuple[int, ...]


# --- by hand ---------------------------------------------------------------------------------------------------------


def reach(x: float, first: ca.SX, second: ca.SX) -> ca.SX:
    """Return the end of a leg of the five-bar in its plane, x and z."""
    along = [ca.vertcat(ca.cos(angle), ca.sin(angle)) for angle in (first, first + second)]
    return ca.vertcat(x, 0) + 0.20 * along[0] + 0.32 * along[1]


def close_five_bar(q: ca.SX) -> ca.SX:
    """Return the distance between the two ends."""
    return reach(-0.05, q[0], q[1]) - reach(0.05, q[2], q[3])


def end_five_bar(q: ca.SX) -> ca.SX:
    """Return the distance of the foot from its target."""
    return reach(-0.05, q[0], q[1]) - ca.vertcat(0.08, -0.42)


def clear_stone(q: ca.SX) -> ca.SX:
    """Return the clearance of the foot, squared, above the least."""
    return ca.sumsqr(reach(-0.05, q[0], q[1]) - ca.vertcat(0.01, -0.44)) - 0.065**2


def turn_y(angle: ca.SX, v: ca.SX) -> ca.SX:
    """Turn a vector about y."""
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(c * v[0] + s * v[2], v[1], c * v[2] - s * v[0])


def turn_z(angle: Any, v: ca.SX) -> ca.SX:
    """Turn a vector about z."""
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(c * v[0] - s * v[1], s * v[0] + c * v[1], v[2])


def close_delta(q: ca.SX) -> ca.SX:
    """Return the distances of the balls from the ends of the rods."""
    gaps = []
    for k in range(3):
        arm, first, second = q[3 * k], q[3 * k + 1], q[3 * k + 2]
        rod = turn_y(first, turn_z(second, ca.SX([0.48, 0, 0]))) + ca.SX([0.22, 0, 0])
        elbow = turn_y(arm, rod) + ca.SX([0.12 - 0.045, 0, 0])
        gaps.append(turn_z(2 * np.pi * k / 3, elbow) - q[9:12])
    return ca.vertcat(*gaps)


def end_delta(q: ca.SX) -> ca.SX:
    """Return the distance of the platform from its target."""
    return q[9:12] - ca.SX([0.15, -0.02, -0.5])


def clear_wall(q: ca.SX) -> ca.SX:
    """Return the clearance above the wall."""
    return (q[9] / 0.05) ** 2 + ((q[11] + 0.5) / 0.06) ** 2 - 1


MECHANISMS = (
    Mechanism("five_bar_reach.ocp.yaml", "five_bar.yaml", close_five_bar, clear_stone, end_five_bar, (0, 2)),
    Mechanism("delta_pick.ocp.yaml", "delta.yaml", close_delta, clear_wall, end_delta, (0, 3, 6)),
)


def write_residual(tree: Tree) -> ca.Function:
    """Return the residual of the tree without its loops, and with the motors' inertia."""
    short = write_functions(tree, ("impl",))["impl"]
    q, qd, qdd, u = (ca.SX.sym(short.name_in(i), short.size1_in(i)) for i in range(4))
    motors = ca.DM([float(body.joint.armature) for body in tree.bodies])
    return ca.Function("tree", [q, qd, qdd, u], [short(q, qd, qdd, u) + motors * qdd], {"cse": True})


# --- the peer --------------------------------------------------------------------------------------------------------


class LoopPeer:
    """The form with multipliers in plain CasADi."""

    def __init__(
        self, problem: Problem, mechanism: Mechanism, residual: ca.Function, settings: Settings, shelf: Shelf | None
    ) -> None:
        """Write the program, and make IPOPT for it; with a shelf, its functions are compiled."""
        N, d, n, m = problem.intervals, problem.degree, len(problem.start_q), len(problem.bounds.u)
        step = problem.horizon / N
        C, D, _ = ca.collocation_coeff(ca.collocation_points(d, problem.family.value))
        q, qd, z = (ca.SX.sym(name, n) for name in ("q", "qd", "z"))
        h = mechanism.close(q)
        k, J = h.numel(), ca.jacobian(h, q)
        lam, mu, u = ca.SX.sym("lam", k), ca.SX.sym("mu", k), ca.SX.sym("u", m)
        point = ca.Function(
            "point",
            [q, qd, z, lam, mu, u],
            [qd + J.T @ mu, ca.vertcat(residual(q, qd, z, u) - J.T @ lam, h, J @ qd), mechanism.path(q)],
            {"cse": True},
        )
        end = ca.Function("end", [q, qd], [ca.vertcat(mechanism.end(q), qd[list(mechanism.independent)])])
        self.k, self.problem, size = k, problem, 3 * n + 2 * k
        v, last = ca.MX.sym("v", 2 * n + d * size + m, N), ca.MX.sym("last", 2 * n)
        mesh, points = ca.horzcat(v[: 2 * n, :], last), ca.reshape(v[2 * n : -m, :], size, N * d)
        U = ca.reshape(ca.repmat(v[-m:, :], d, 1), m, N * d)
        Q, QD, Z, LAM, MU = ca.vertsplit(points, [0, n, 2 * n, 3 * n, 3 * n + k, size])
        rates, rows, paths = point.map(N * d)(Q, QD, Z, LAM, MU, U)
        slopes, states = ca.vertcat(rates, Z), ca.vertcat(Q, QD)
        nodes = [mesh[:, :N], *(states[:, j::d] for j in range(d))]
        equations = []
        for j in range(d):
            derivative = sum((C[r, j] * nodes[r] for r in range(d + 1)), start=ca.MX(2 * n, N))
            equations += [derivative - step * slopes[:, j::d], rows[:, j::d]]
        following = sum((D[r] * nodes[r] for r in range(d + 1) if abs(float(D[r])) > 1e-12), start=ca.MX(2 * n, N))
        g = [
            mesh[:, 0] - np.array(problem.start_q + problem.start_qd),
            ca.vec(ca.vertcat(*equations, following - mesh[:, 1:])),
            end(last[:n], last[n:]),
        ]
        fixed = sum(part.numel() for part in g)
        nlp = {
            "x": ca.vertcat(ca.vec(v), last),
            "f": problem.cost.inputs * step * ca.sumsqr(v[-m:, :]),
            "g": ca.vertcat(*g, ca.vec(paths)),
        }
        options = list_options(settings, shelf)
        self._solver = ca.nlpsol("peer", "ipopt", nlp, options)
        if shelf is not None:
            self._solver, _ = compile_solver(self._solver, options, shelf)
        self._upper_rows = np.concatenate((np.zeros(fixed), np.full(N * d, np.inf)))
        bounds = np.array(problem.bounds.q + problem.bounds.qd)
        free = np.tile((-np.inf, np.inf), (n + 2 * k, 1))
        inputs = np.array(problem.bounds.u).reshape(-1, 2)
        column = np.concatenate((bounds, *[np.concatenate((bounds, free))] * d, inputs))
        self._lower, self._upper = np.concatenate((*[column] * N, bounds)).T

    def solve(self, guess: Trajectory, multipliers: Array) -> Effort:
        """Solve from a guess."""
        begin = time.process_time()
        answer = self._solver(
            x0=self._pack(guess, multipliers), lbx=self._lower, ubx=self._upper, lbg=0, ubg=self._upper_rows
        )
        seconds, statistics = time.process_time() - begin, self._solver.stats()
        evaluating = sum(value for key, value in statistics.items() if key.startswith("t_proc_nlp_"))
        cost = float(answer["f"])
        return Effort(statistics["return_status"], statistics["iter_count"], cost, seconds, evaluating)

    def _pack(self, guess: Trajectory, multipliers: Array) -> Array:
        parts, corrections = [guess.q[0], guess.qd[0]], np.zeros(self.k)
        for i in range(self.problem.intervals):
            for j in range(self.problem.degree):
                at = (guess.point_q[i, j], guess.point_qd[i, j], guess.point_qdd[i, j])
                parts += [*at, multipliers[i, j], corrections]
            parts += [guess.u[i], guess.q[i + 1], guess.qd[i + 1]]
        return np.concatenate(parts)


def check(mechanism: Mechanism, residual: ca.Function, plant: Plant) -> None:
    """Compare the peer's dynamics and loops with ours at random states, to 1e-9. Raises DisagreementError."""
    manifest, rng = plant.manifest, np.random.default_rng(5)
    n, m = len(manifest.coordinates), len(manifest.dependent)
    q, qd, qdd = rng.uniform(-1, 1, (3, n))
    u = rng.uniform(-1, 1, len(manifest.actuated))
    ours = plant("impl", q=q, qd=qd, qdd=qdd, lam=np.zeros(m), u=u)["Phi"]
    error = np.abs(ours - residual(q, qd, qdd, u).full().ravel()).max()
    symbol = ca.SX.sym("q", n)
    J = ca.Function("J", [symbol], [ca.jacobian(mechanism.close(symbol), symbol)])
    theirs = J(np.array(manifest.pose)).full()
    closure = Closure(plant)
    pose = closure.close(np.array(manifest.pose))
    theirs, own = J(pose).full(), closure.jacobian(pose[None])[0]
    turned = own - own @ np.linalg.pinv(theirs) @ theirs  # rows of one space
    if not max(error, np.abs(turned).max()) <= 1e-9:
        raise DisagreementError(f"{mechanism.model}: off by {error:.1e} and {np.abs(turned).max():.1e}")


# --- measurement -----------------------------------------------------------------------------------------------------


def solve_ours(solver: Solver, problem: Problem, guess: Trajectory) -> Effort:
    """Solve with the generated kernels."""
    outcome = solver.solve(problem, guess)
    run, cost = outcome.run, outcome.cost.total if isinstance(outcome, Solution) else float("nan")
    return Effort(run.status, run.iterations, cost, run.cpu_seconds, run.cpu_seconds_evaluating)


def make_ways(mechanism: Mechanism, shelf: Shelf | None) -> Mapping[str, Callable[[], Effort]]:
    """Make all ways to solve the task of a mechanism, ours first."""
    problem, plant = read_problem(MODELS / mechanism.problem, load_on_demand)
    guess = make_guess(problem, plant, schemes.build(problem.family, problem.degree))
    assert isinstance(guess, Trajectory), "the target is within reach"
    ways: dict[str, Callable[[], Effort]] = {}
    for loops in (Loops.REDUCED, Loops.MULTIPLIERS):
        for words, solver in (
            (f", {STAGES}", replace(problem.solver, method="mbs", options=())),
            ("", replace(problem.solver, method="ipopt", options=tuple(EXACT.items()))),
        ):
            chosen = replace(problem, loops=loops, solver=solver)
            ways[f"{OURS}, {loops.value}{words}"] = partial(solve_ours, Solver(chosen, plant), chosen, guess)
    residual = write_residual(read_tree(MODELS / mechanism.model))
    multipliers, _ = find_point_forces(plant, guess)
    check(mechanism, residual, plant)
    settings = {name: replace(s, ipopt={**s.ipopt, **EXACT}) for name, s in list_settings(problem).items()}
    for name, setting in settings.items():
        peer = LoopPeer(problem, mechanism, residual, setting, None)
        ways[f"CasADi, interpreted, {name}"] = partial(peer.solve, guess, multipliers)
    if shelf is not None:
        for name in TUNED:
            peer = LoopPeer(problem, mechanism, residual, settings[name], shelf)
            ways[f"CasADi, compiled, {name}"] = partial(peer.solve, guess, multipliers)
    return ways


def measure(mechanism: Mechanism, shelf: Shelf | None, rounds: int) -> list[tuple[str, ...]]:
    """Solve every way once a round, and return the cells of a table: the quickest of each way, and its median."""
    ways = make_ways(mechanism, shelf)
    efforts = {name: [solve()] for name, solve in ways.items()}  # the first makes functions, and warms up
    for _ in range(rounds):
        for name, solve in ways.items():
            efforts[name].append(solve())
    best = {name: min(tries[1:], key=lambda effort: effort.cpu_seconds) for name, tries in efforts.items()}
    ours = next(iter(best.values()))
    rows: list[tuple[str, ...]] = []
    for name, effort in best.items():
        algebra = effort.cpu_seconds - effort.cpu_seconds_evaluating
        median = statistics.median(effort.cpu_seconds for effort in efforts[name][1:])
        is_same = abs(effort.cost - ours.cost) <= SAME * abs(ours.cost)
        rows.append(
            (
                name,
                str(effort.iterations),
                f"{1e3 * effort.cpu_seconds_evaluating:.1f}",
                f"{1e3 * algebra:.1f}",
                f"{1e3 * effort.cpu_seconds:.1f}",
                f"{1e3 * median:.1f}",
                f"{effort.cpu_seconds / ours.cpu_seconds:#.3g}",
                f"{effort.cost:.8g}" if is_same else f"{effort.cost:.8g}, another ({effort.status})",
            )
        )
    return rows


def show(title: str, rows: Sequence[Sequence[str]]) -> Table:
    """Lay rows out for a terminal."""
    table = Table(title=title, box=box.SIMPLE)
    for column in COLUMNS:
        table.add_column(column, justify="left" if column == "way" else "right")
    for row in rows:
        table.add_row(*row)
    return table


def write_page(tables: Mapping[str, Sequence[Sequence[str]]], rounds: int) -> str:
    """Write all tables, and what they hold, in Markdown."""
    lines = [
        "# Optimal control of closed loops: what was measured",
        "",
        f"`python -m benchmarks.ocp.loops -o FILE` wrote this page: {describe_machine()}; {rounds} rounds.",
        "Times are of the processor, in ms, of the quickest round; the median of whole solves stands beside it.",
        "Ratios are relative to the first row. [The ways](../ocp/README.md#closed-loops) are described there.",
    ]
    for title, rows in tables.items():
        lines += ["", f"## {title}", "", f"| {' | '.join(COLUMNS)} |", "|---" + "|---:" * (len(COLUMNS) - 1) + "|"]
        lines += [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join([*lines, ""])


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.ocp.loops", description=__doc__)
    parser.add_argument("--compiled", action="store_true", help="also compile what CasADi writes, which takes long")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("-o", "--output", type=Path, help="also write the tables to this file, in Markdown")
    given = parser.parse_args(arguments)
    shelf = Shelf(find_cache() / "ocp") if given.compiled else None
    console = Console(width=140)
    tables: dict[str, list[tuple[str, ...]]] = {}
    console.print(describe_machine())
    for mechanism in MECHANISMS:
        tables[mechanism.problem] = measure(mechanism, shelf, given.rounds)
        console.print(show(mechanism.problem, tables[mechanism.problem]))
    if given.output:
        given.output.write_text(write_page(tables, given.rounds), "utf-8")


if __name__ == "__main__":
    main()
