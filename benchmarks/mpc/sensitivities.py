"""Derivatives of solutions, and many solves, beside acados: `python -m benchmarks.mpc.sensitivities`.

The task is the one of `benchmarks.mpc`: a Panda between bounds, on the generated kernels. Each solver solves from 64
starts at rest, drawn at random near the usual one, in turn on one core, cold. All ends are compared. At the usual start
the derivative of the first accelerations by the first state, 7 by 14, is computed from the solution, and compared with
differences of order four of IPOPT's solutions to 1e-12. acados' only wheel has forward sensitivities by the first state
(`eval_param_sens`, with the factors of its last quadratic program), and neither adjoint ones nor its batched solver. On
one core that solver is a loop over solves, as here. Gauss's and Newton's Hessian, for which these kernels are given,
leaves out the curvature of torques, which the derivative has. Ours takes a factorisation at the solution, and one sweep
for each state (`mbs_stages_gain`). The gradient of one function, the sum of the first accelerations, takes one sweep
(`mbs_stages_adjoint`); acados forms it from all 14 states. Times are processor time in calls of C.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from benchmarks.compilation import describe_machine
from benchmarks.mpc.acados_peer import AcadosPeer, Session, Settings, is_installed
from benchmarks.mpc.casadi_peers import MODEL, REFERENCE, CasadiPeer, load_torque
from benchmarks.mpc.contest import Start, choose
from benchmarks.mpc.own import OwnRunner, list_settings
from benchmarks.mpc.problem import JOINTS, STATES, Answer, Array, Slopes, Task, rest
from benchmarks.pages import tabulate

STARTS = 64
SPREAD = 0.15  # of starts [rad]
STEP = 1e-4  # of differences
ROUNDS = 5


@dataclass(frozen=True)
class Found:
    """The figures of a solver."""

    name: str
    settings: str
    tried: int
    solved: int  # of the starts
    error: float  # of states and accelerations, the largest, as a part of their ranges
    solve: Array  # s of a start, by round
    slopes: Array  # s of the derivative, by round
    gradient: Array  # s of the gradient of one function, by round
    deviation: float  # of the derivative, over its largest entry
    mismatch: float  # of the gradient


def list_acados(intervals: int) -> Sequence[Settings]:
    """List the options that are searched for acados."""
    grid = product(("SPEED", "BALANCE"), (0, intervals // 4), (0, 1), (1e-6, 1e-7))
    return [Settings(mode, 1, blocks, warm, tolerance) for mode, blocks, warm, tolerance in grid]


def draw(task: Task, count: int) -> list[Array]:
    """Draw first states at rest."""
    moves = np.random.default_rng(0).uniform(-SPREAD, SPREAD, (count, JOINTS))
    return [np.concatenate((task.start + move, np.zeros(JOINTS))) for move in moves]


def solve_from(task: Task, runner: OwnRunner | AcadosPeer | CasadiPeer, state: Array) -> Answer:
    """Solve cold from a state at rest."""
    runner.prepare(state, rest(replace(task, start=state[:JOINTS])), shifts=False)
    return runner.solve()


def differentiate(task: Task, exact: CasadiPeer, state: Array) -> Array:
    """Return the derivative of the first accelerations by the first state, (7, 14), by differences of solutions."""

    def find(step: Array) -> Array:
        return np.array(solve_from(task, exact, state + step).iterate.a[0])

    columns = []
    for direction in STEP * np.eye(STATES):
        a, b, c, d = (find(k * direction) for k in (-2, -1, 1, 2))
        columns.append((8 * (c - b) - (d - a)) / (12 * STEP))
    return np.stack(columns, axis=1)


def compare(found: Array, truth: Array) -> float:
    """Return the largest deviation, over the largest entry."""
    return float(np.abs(found - truth).max() / np.abs(truth).max())


def measure(task: Task, starts: int, rounds: int, session: Session | None) -> list[Found]:
    """Measure all solvers in turn."""
    exact, first = CasadiPeer(task, REFERENCE, load_torque()), OwnRunner(task, MODEL)
    usual = np.concatenate((task.start, np.zeros(JOINTS)))
    runners: dict[str, list[OwnRunner] | list[AcadosPeer]] = {
        "mbs": [first, *(OwnRunner(task, MODEL, x, first) for x in list(list_settings())[1:])]
    }
    if session is not None:
        runners["acados"] = [AcadosPeer(task, session, x) for x in list_acados(task.intervals)]
    begun = Start(usual, rest(task), solve_from(task, exact, usual).iterate)
    choices = {name: choose(task, every, begun) for name, every in runners.items()}
    states, truth = draw(task, starts), differentiate(task, exact, usual)
    ends = [solve_from(task, exact, state).iterate for state in states]
    found: dict[str, list[tuple[list[Answer], Slopes]]] = {name: [] for name in choices}
    for _ in range(rounds):
        for name, choice in choices.items():
            runner = choice.runner
            assert isinstance(runner, OwnRunner | AcadosPeer)
            answers = [solve_from(task, runner, state) for state in states]
            solve_from(task, runner, usual)
            found[name].append((answers, runner.differentiate()))
    rows = []
    for name, choice in choices.items():
        answers, slopes = found[name][0]
        pairs = zip(answers, ends, strict=True)
        errors = [task.measure_error(x.iterate, end) for x, end in pairs if x.is_solved]
        rows.append(
            Found(
                name,
                str(choice.runner.settings),
                choice.tried,
                len(errors),
                max(errors, default=np.nan),
                np.array([[x.seconds for x in own] for own, _ in found[name]]).mean(axis=1),
                np.array([own.seconds for _, own in found[name]]),
                np.array([own.gradient_seconds for _, own in found[name]]),
                compare(slopes.matrix, truth),
                compare(slopes.gradient, truth.sum(axis=0)),
            )
        )
    return rows


def write_page(rows: Sequence[Found], task: Task, starts: int) -> str:
    """Write the page."""
    own = rows[0]

    def relate(read: Callable[[Found], Array], row: Found) -> str:
        return f"{float(np.median(read(row) / read(own))):.2f}"

    table = [
        (
            row.name,
            f"{row.solved} of {starts}",
            f"{row.error:.1e}",
            f"{1e3 * row.solve.min():.3g}",
            relate(lambda x: x.solve, row),
            f"{1e6 * row.slopes.min():.3g}",
            relate(lambda x: x.slopes, row),
            f"{row.deviation:.1e}",
            f"{1e6 * row.gradient.min():.3g}",
            relate(lambda x: x.gradient, row),
            f"{row.mismatch:.1e}",
        )
        for row in rows
    ]
    titles = (
        "solver", "solved", "largest error", "solve [ms]", "over ours", "7 × 14 [µs]", "over ours", "its error",
        "gradient [µs]", "over ours", "its error",
    )  # fmt: skip
    heading = (__doc__ or "").partition("\n\n")[2].strip()
    options = [f"- {row.name}: {row.settings}, of {row.tried} settings" for row in rows]
    return "\n".join(
        [
            "# Derivatives and many solves beside acados",
            "",
            heading,
            "",
            f"The horizon has {task.intervals} intervals. On {describe_machine()}.",
            "",
            *tabulate(titles, table),
            "",
            "Errors of solves are parts of the ranges of bounds, the ones of derivatives are over the largest entry.",
            "Ratios are medians over rounds in turn. Options:",
            "",
            *options,
            "",
        ]
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=Path("build/sensitivities.md"), help="the page")
    parser.add_argument("--starts", type=int, default=STARTS)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    given = parser.parse_args(arguments)
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    if not is_installed():
        print("acados is left out: python3 tests/acados.py build/acados installs it")
    task = Task()
    with ExitStack() as stack:
        session = stack.enter_context(Session(task)) if is_installed() else None
        rows = measure(task, given.starts, given.rounds, session)
    given.output.parent.mkdir(parents=True, exist_ok=True)
    given.output.write_text(write_page(rows, task, given.starts), encoding="utf-8")
    print(given.output.read_text("utf-8"))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
