"""The project's own solver: the task as a program in stages, solved by csrc/stages, and in real time.

Torques u are inner variables of a step, which the equations Phi(q, qd, a) - u = 0 give, so their bounds are bounds of
variables; a guess gets the torques that its motion takes. Cold solves take multipliers of 0, shifted ones the
multipliers of the solution before, as fatrop and IPOPT would if CasADi gave them. Times are of the calls in C.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from benchmarks.mpc.problem import JOINTS, STATES, Answer, Array, Iterate, Latency, Slopes, Task, wait
from mbsgen.expressions import parse
from mbsrun.external import OnDemand
from mbsrun.ocp.evaluation.stages.binding import Numbers, Tables, Workspace, fill, set_bounds
from mbsrun.ocp.evaluation.stages.building import build
from mbsrun.ocp.ground.functions import Formula, Input, KernelResult
from mbsrun.ocp.ground.program import Block, Program, Stages

LEAST_BARRIER = 1e-5  # of real-time steps
SHARP_BARRIER = 1e-9  # of derivatives
SIZE = STATES + 2 * JOINTS  # of a stage: q, qd, a, u


def write_program(task: Task) -> Program:
    """Write the task as data: rows of the start, of the dynamics, of inverse dynamics."""
    N, n = task.intervals, JOINTS
    first = SIZE * np.arange(N + 1)[:, None]
    states, a = first + np.arange(STATES), first[:-1] + STATES + np.arange(n)
    u = first[:-1] + STATES + n + np.arange(n)
    variables, start = N * SIZE + STATES, np.arange(STATES)
    dynamics = STATES + np.arange(N * STATES).reshape(N, STATES)
    torques = STATES * (N + 1) + np.arange(N * n).reshape(N, n)
    A = sparse.lil_array((STATES * (N + 1) + N * n, variables))
    A[start, states[0]] = 1.0
    for k in range(N):
        A[dynamics[k], states[k + 1]] = 1.0
        A[np.ix_(dynamics[k], states[k])] = -task.A
        A[np.ix_(dynamics[k], a[k])] = -task.B
    weights, ends = np.repeat(task.weights[:2], n), np.repeat(task.end_weights, n)
    diagonal = np.zeros(variables)
    diagonal[states[:-1]], diagonal[a], diagonal[states[-1]] = task.step * weights, task.step * task.weights[2], ends
    pull = " - ".join(["0", *(f"({x!r})*x{i}" for i, x in enumerate(task.target.tolist()))])
    towards = Formula((parse(pull),), {f"x{i}": ("x", i) for i in range(n)}, (Input("x", n),))
    scale = np.append(np.full(N, task.step * task.weights[0]), task.end_weights[0])
    rows = np.concatenate([np.zeros(STATES), np.repeat(np.arange(N), STATES), np.repeat(np.arange(N), n)])
    residual = KernelResult("impl", ("q", "qd", "qdd", "u"), "Phi")
    columns = (states[:-1, :n].T, states[:-1, n:].T, a.T, u.T)
    cost = Block(towards, (states[:, :n].T,), np.zeros((1, N + 1), dtype=np.int64), np.arange(N + 1), scale=scale)
    return Program(
        A=A.tocsc(),
        H=(sparse.diags_array(diagonal).tocsc(),),
        blocks=(Block(residual, columns, torques.T, np.arange(N)),),
        costs=(cost,),
        stages=Stages(
            states=states,
            inputs=a,
            inner=u[:, None],
            equations=torques[:, None],
            continuity=dynamics,
            common=np.zeros(0, dtype=np.int64),
            rows=rows.astype(np.int64),
        ),
    )


@dataclass(frozen=True)
class Settings:
    """Options of the solver."""

    tolerance: float = 1e-8  # these are its defaults
    barrier: float = 1e-7  # of the first step from a solution

    def __str__(self) -> str:
        """Name them."""
        return f"tolerance {self.tolerance:g}, first barrier from a solution {self.barrier:g}"


def list_settings() -> Iterator[Settings]:
    """List the grid of options that is searched; the defaults are the first."""
    yield Settings()
    for tolerance, barrier in product((1e-8, 1e-7, 1e-6), (1e-9, 1e-8, 1e-7, 1e-6)):
        if Settings(tolerance, barrier) != Settings():
            yield Settings(tolerance, barrier)


class OwnRunner:
    """A task, its tables, and a solver."""

    name = "mbs"

    def __init__(self, task: Task, model: Path, settings: Settings = Settings(), like: OwnRunner | None = None) -> None:
        """Build the tables, or share another one's, of the same task."""
        self._task, self.settings = task, settings
        if like is None:
            plant = OnDemand(model)
            self._torque = plant.casadi("impl")
            self._tables = Tables(build(write_program(task), plant), plant)
        else:
            self._torque, self._tables = like._torque, like._tables
        self._workspace: Workspace | None = None
        self._kept: tuple[NDArray[np.uint8], Array] = np.zeros(0, dtype=np.uint8), np.zeros(0)
        self._solved = np.zeros(0, dtype=np.uint8)  # the memory after a solve that did not shift
        self._options: Any = None
        self._shifts = False

    def prepare(self, start: Array, guess: Iterate, *, shifts: bool) -> None:
        """Keep where solves begin."""
        workspace = self._lay(start)
        if shifts:
            workspace.memory[:] = self._solved
            self._tables.lib.mbs_stages_shift(workspace.solver)
        self._shifts = shifts
        self._kept = workspace.memory.copy(), fill(workspace.evaluator, self._pack(guess))
        self._options = self._make_options(
            **({"warm_start_init_point": 1, "mu_init": self.settings.barrier} if shifts else {})
        )

    def solve(self) -> Answer:
        """Solve once."""
        workspace = self._workspace
        assert workspace is not None, "solves are prepared"
        workspace.memory[:], workspace.point.w[:] = self._kept
        begin = time.process_time()
        result = self._tables.lib.mbs_stages_solve(workspace.solver, self._options)
        seconds = time.process_time() - begin
        if not self._shifts:
            self._solved = workspace.memory.copy()
        return self._read(result, seconds)

    def differentiate(self) -> Slopes:
        """Differentiate at the last solution: factorise there, and sweep once for each first state, or for the sum."""
        workspace, lib = self._workspace, self._tables.lib
        assert workspace is not None, "there is a solution"
        options = self._make_options(mu_target=SHARP_BARRIER)
        ffi, size, columns = self._tables.ffi, workspace.point.w.size, list[Array]()
        begin = time.process_time()
        prepared = lib.mbs_stages_prepare(workspace.solver, options, 0)
        seconds = preparing = time.process_time() - begin
        if prepared.status != lib.MBS_STAGES_PREPARED:
            raise RuntimeError(f"the derivative ended with {prepared.status}")
        first = lib.mbs_stages_places(workspace.solver, 0).v
        for j in range(STATES):
            begin = time.process_time()
            found = lib.mbs_stages_gain(workspace.solver, j)
            seconds += time.process_time() - begin
            columns.append(np.frombuffer(ffi.buffer(found, 8 * size))[first + JOINTS : first + 2 * JOINTS].copy())
        weights, gradient = np.zeros(size), np.zeros(STATES)
        weights[first + JOINTS : first + 2 * JOINTS] = 1.0
        given = ffi.from_buffer("double[]", weights), ffi.from_buffer("double[]", gradient)
        begin = time.process_time()
        failed = lib.mbs_stages_adjoint(workspace.solver, *given)
        adjoint = preparing + time.process_time() - begin
        if failed:
            raise RuntimeError("the adjoint is no number")
        return Slopes(np.stack(columns, axis=1), seconds, gradient, adjoint)

    def control(self, steps: int) -> Latency:
        """Move the robot in real time from rest, from a converged solution: one step of Newton's method a period."""
        task, lib, ffi = self._task, self._tables.lib, self._tables.ffi
        workspace = self._lay(np.concatenate([task.start, np.zeros(JOINTS)]))
        options = self._make_options(mu_target=LEAST_BARRIER)
        lib.mbs_stages_solve(workspace.solver, options)
        x, inner = np.concatenate([task.start, np.zeros(JOINTS)]), np.zeros(2 * JOINTS)
        times: list[tuple[float, float]] = []
        path = np.zeros((steps, STATES + JOINTS))
        for k in range(steps):
            begin = time.perf_counter()
            prepared = lib.mbs_stages_prepare(workspace.solver, options, int(k > 0))
            middle = time.perf_counter()
            made = lib.mbs_stages_feedback(
                workspace.solver, ffi.from_buffer("double[]", x), ffi.from_buffer("double[]", inner)
            )
            times.append((middle - begin, time.perf_counter() - middle))
            if (prepared.status, made.status) != (lib.MBS_STAGES_PREPARED, lib.MBS_STAGES_STEPPED):
                raise RuntimeError(f"step {k}: statuses {prepared.status} and {made.status}")
            path[k] = *x, *inner[JOINTS:]
            x = task.A @ x + task.B @ inner[JOINTS:]
        prepare, feedback = np.array(times).T
        idle = wait(float(np.median(feedback)), steps)
        return Latency(prepare, feedback, idle, path[:, :STATES], path[:, STATES:], x)

    def _lay(self, start: Array) -> Workspace:
        """Set the bounds; the start is one of them."""
        task, N = self._task, self._task.intervals
        free = np.full(STATES, np.inf)
        inner = np.concatenate([task.upper_x, task.acceleration, task.torque])
        lower = np.concatenate([task.lower_x, -task.acceleration, -task.torque])
        least = np.concatenate([start, np.zeros(N * (STATES + JOINTS))])
        numbers = Numbers(
            parameters=np.ones(1),
            lower=np.concatenate([-free, np.tile(lower, N)[STATES:], task.lower_x]),
            upper=np.concatenate([free, np.tile(inner, N)[STATES:], task.upper_x]),
            least=least,
            most=least,
        )
        bounds = set_bounds(self._tables.data, numbers)
        if self._workspace is None:
            self._workspace = Workspace(self._tables, numbers.parameters, bounds)
        for held, given in zip(self._workspace.bounds, bounds, strict=True):
            held[: given.size] = given
        return self._workspace

    def _make_options(self, **values: float) -> Any:
        options = self._tables.ffi.new("mbs_stages_options *", self._tables.lib.mbs_stages_default_options())
        options.tol = self.settings.tolerance
        for name, value in values.items():
            setattr(options, name, value)
        return options

    def _pack(self, guess: Iterate) -> Array:
        """Add the torques that a guess takes: for the other solvers they are no variables."""
        q, qd = guess.x[:-1, :JOINTS], guess.x[:-1, JOINTS:]
        torques = self._torque(q.T, qd.T, guess.a.T, 0).full().T
        stages = np.hstack([guess.x[:-1], guess.a, torques])
        return np.append(stages.ravel(), guess.x[-1])

    def _read(self, result: Any, seconds: float) -> Answer:
        assert self._workspace is not None, "a solve has a workspace"
        x = np.zeros(self._task.intervals * SIZE + STATES)
        known = self._tables.data.variables >= 0
        x[self._tables.data.variables[known]] = self._workspace.point.w[known]
        stages = x[:-STATES].reshape(-1, SIZE)
        iterate = Iterate(np.vstack([stages[:, :STATES], x[-STATES:]]), stages[:, STATES : STATES + JOINTS])
        status = self._tables.ffi.typeof("mbs_stages_status").elements[result.status]
        is_solved = status == "MBS_STAGES_SOLVED"
        return Answer(status.removeprefix("MBS_STAGES_").lower(), is_solved, result.iterations, iterate, seconds)
