"""acados by SQP, with HPIPM for its quadratic programs, given the kernels: sequential, full steps, Gauss and Newton.

acados lives in a separate environment, `python3 tests/acados.py build/acados`; so a process there solves. Its
constraint functions are C that CasADi writes here around the kernels, with one call of each.
"""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import chdir
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import casadi as ca
import numpy as np

from benchmarks.mpc.casadi_peers import MODEL
from benchmarks.mpc.problem import JOINTS, STATES, Answer, Array, Iterate, Latency, Slopes, Task, rest, wait
from mbsrun.external import OnDemand
from tests import acados

ENVIRONMENT = Path(__file__).parents[2] / "build" / "acados"
PROGRAM = Path(__file__).with_name("acados_program.py")


@dataclass(frozen=True)
class Settings:
    """Options of acados and of HPIPM that a user may choose from."""

    mode: str = "BALANCE"  # of HPIPM: these are acados' own defaults
    riccati: int = 1  # 0: classical; 1: by square roots
    blocks: int = 0  # the stages of the condensed program; 0: one a step
    warm: int = 0  # quadratic programs: 0 cold, 1 warm, 2 hot
    tolerance: float = 1e-6
    precision: float = 1.0  # of the quadratic programs, over the tolerance
    multipliers: str = "zero"  # or `kept`: from the solution before
    method: str = "SQP"

    def __str__(self) -> str:
        """Name the settings as acados does."""
        root = "square root" if self.riccati else "classical"
        warm = ("cold", "warm", "hot")[self.warm]
        blocks = self.blocks or "all"
        own = f"{self.tolerance:g}, {self.precision * self.tolerance:g} of HPIPM"
        return f"{self.mode}, {root}, {blocks} blocks, {warm} programs, {self.multipliers} multipliers, {own}"


def list_settings(intervals: int) -> Iterator[Settings]:
    """List the grid of options that is searched; acados' defaults are the first."""
    yield Settings()
    modes, blocks = ("SPEED", "BALANCE", "ROBUST"), (0, intervals // 2, intervals // 4)  # SPEED_ABS ends nowhere
    tolerances, precisions, multipliers = (1e-6, 1e-7, 1e-8), (1.0, 0.1), ("kept", "zero")
    for mode, riccati, parts, warm, tolerance, precision, kept in product(
        modes, (1, 0), blocks, (0, 1, 2), tolerances, precisions, multipliers
    ):
        found = Settings(mode, riccati, parts, warm, tolerance, precision, kept)
        if found != Settings():
            yield found


def list_steps(intervals: int) -> Iterator[Settings]:
    """List the grid of options that is searched for steps in real time."""
    blocks = (0, intervals // 2, intervals // 4, intervals // 10)
    tolerances = (1e-3, 1e-4, 1e-6)
    for mode, riccati, parts, warm, tolerance in product(("SPEED", "BALANCE"), (1, 0), blocks, (0, 1, 2), tolerances):
        yield Settings(mode, riccati, parts, warm, tolerance, 1.0, "kept", "SQP_RTI")


def is_installed() -> bool:
    """Return whether the environment is there."""
    return (ENVIRONMENT / "source" / "lib").exists()


def write_constraints(folder: Path) -> None:
    """Write C of the torques under acados' names: (x, u, z, p) -> h, and h, dh/d(u, x) transposed, dh/dz."""
    torque = OnDemand(MODEL).casadi("impl")
    x, u, z, p = (ca.MX.sym(name, size) for name, size in (("x", STATES), ("u", JOINTS), ("z", 0), ("p", 0)))
    arguments: list[Any] = [x[:JOINTS], x[JOINTS:], u, ca.DM.zeros(JOINTS)]
    h = torque(*arguments)
    by_q, by_qd, by_a, _ = torque.jacobian()(*arguments, h)
    slopes = ca.densify(ca.horzcat(by_a, by_q, by_qd).T)
    outputs = {"fun": [h], "fun_jac_uxt_zt": [h, slopes, ca.MX(JOINTS, 0)]}
    with chdir(folder):  # CasADi writes to where it is
        for name, found in outputs.items():
            function = f"panda_constr_h_{name}"
            ca.Function(function, [x, u, z, p], found).generate(function, {"casadi_int": "int"})


class Session:
    """A process in acados' environment with a task; its solvers are built once for all settings that share them."""

    def __init__(self, task: Task) -> None:
        """Start it."""
        self._folder = tempfile.TemporaryDirectory()
        write_constraints(Path(self._folder.name))
        file = Path(self._folder.name) / "task.json"
        file.write_text(json.dumps(_describe(task, self._folder.name)), "utf-8")
        self._errors = (Path(self._folder.name) / "errors.txt").open("w+", encoding="utf-8")
        self._process = subprocess.Popen(
            [ENVIRONMENT / "bin" / "python", PROGRAM, file],
            env={**os.environ, **acados.variables(ENVIRONMENT)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            text=True,
        )

    def __enter__(self) -> Self:
        """Use it as a context."""
        return self

    def __exit__(
        self, _: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        """End the process."""
        self._process.communicate()
        self._errors.close()
        self._folder.cleanup()

    def ask(self, do: str, **request: Any) -> dict[str, Any]:
        """Send a request; return the answer."""
        asked, answers = self._process.stdin, self._process.stdout
        assert asked is not None
        assert answers is not None
        asked.write(json.dumps({"do": do, **request}) + "\n")
        asked.flush()
        line = answers.readline()
        if not line:
            self._errors.seek(0)
            raise RuntimeError(f"acados failed:\n{self._errors.read()[-2000:]}")
        found: dict[str, Any] = json.loads(line)
        return found


def _describe(task: Task, folder: str) -> dict[str, Any]:
    library = OnDemand(MODEL).find_family("impl").compile("impl", "jac_impl")
    return {
        "folder": folder,
        "libraries": [str(library)],
        "N": task.intervals,
        "step": task.step,
        "A": task.A.tolist(),
        "B": task.B.tolist(),
        "W": np.repeat(task.weights, JOINTS).tolist(),
        "E": np.repeat(task.end_weights, JOINTS).tolist(),
        "goal": [*task.target.tolist(), *[0.0] * JOINTS],
        "lower": task.lower_x.tolist(),
        "upper": task.upper_x.tolist(),
        "acceleration": task.acceleration.tolist(),
        "torque": task.torque.tolist(),
    }


class AcadosPeer:
    """A task, solved in acados' environment with some settings."""

    name = "acados"

    def __init__(self, task: Task, session: Session, settings: Settings) -> None:
        """Take a task and its process."""
        self._task, self._session, self.settings = task, session, settings

    def prepare(self, start: Array, guess: Iterate, *, shifts: bool) -> None:
        """Keep where solves begin."""
        given = {"start": start.tolist(), "x": guess.x.tolist(), "a": guess.a.tolist()}
        self._session.ask("prepare", **given, shifts=shifts)

    def solve(self) -> Answer:
        """Solve once."""
        found = self._session.ask("solve", settings=self._fill())
        iterate = Iterate(np.array(found["x"]), np.array(found["a"]))
        return Answer(str(found["status"]), found["status"] == 0, found["iterations"], iterate, found["seconds"])

    def differentiate(self) -> Slopes:
        """Differentiate at the last solution, by the factors of its last quadratic program."""
        found = self._session.ask("differentiate", settings=self._fill())
        matrix, seconds = np.array(found["slopes"]), found["seconds"]
        return Slopes(matrix, seconds, matrix.sum(axis=0), seconds)

    def control(self, steps: int) -> Latency:
        """Move the robot in real time from a solution: one quadratic program a period."""
        start = np.concatenate([self._task.start, np.zeros(JOINTS)])
        self.prepare(start, rest(self._task), shifts=False)
        found = self._session.ask("control", settings=self._fill(), steps=steps)
        if len(found["times"]) < steps or found["status"]:
            raise RuntimeError(f"step {len(found['times'])}: status {found['status']}")
        prepare, feedback = np.array(found["times"]).T
        path, n = np.array(found["path"]), STATES
        idle = wait(float(np.median(feedback)), steps)
        return Latency(prepare, feedback, idle, path[:, :n], path[:, n:], np.array(found["end"]))

    def try_control(self, steps: int, most: float) -> float:
        """Return the time of a step in real time; infinity where it fails, or the way costs more than `most`."""
        try:
            found = self.control(steps)
        except RuntimeError:
            return np.inf
        return float(np.median(found.prepare + found.feedback)) if found.cost(self._task) <= most else np.inf

    def _fill(self) -> dict[str, Any]:
        return asdict(replace(self.settings, blocks=self.settings.blocks or self._task.intervals))
