"""acados by SQP, with HPIPM for its quadratic programs, given the kernels: sequential, full steps, Gauss and Newton.

acados lives in a separate environment, `python3 tests/acados.py build/acados`; so a process there solves. Its
constraint functions are C that CasADi writes here around the kernels, with one call of each.
"""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from contextlib import chdir
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from benchmarks.mpc.casadi_peers import MODEL
from benchmarks.mpc.problem import JOINTS, STATES, Answer, Array, Iterate, Task
from mbsrun.external import OnDemand
from tests import acados

ENVIRONMENT = Path(__file__).parents[2] / "build" / "acados"
PROGRAM = Path(__file__).with_name("acados_program.py")


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


class AcadosPeer:
    """A task, solved in acados' environment."""

    name = "acados"

    def __init__(self, task: Task) -> None:
        """Take a task."""
        self._task = task

    def solve(self, start: Array, guess: Iterate, rounds: int) -> Answer:
        """Build, and solve from a state of the robot and a guess, several times; return the quickest answer."""
        with tempfile.TemporaryDirectory() as folder:
            write_constraints(Path(folder))
            file = Path(folder) / "task.json"
            file.write_text(json.dumps(self._describe(folder, start, guess, rounds)), "utf-8")
            done = subprocess.run(
                [ENVIRONMENT / "bin" / "python", PROGRAM, file],
                env={**os.environ, **acados.variables(ENVIRONMENT)},
                capture_output=True,
                text=True,
                check=False,
            )
        if done.returncode:
            raise RuntimeError(f"acados failed:\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}")
        found = json.loads(done.stdout.splitlines()[-1])
        iterate = Iterate(np.array(found["x"]), np.array(found["a"]))
        return Answer(str(found["status"]), found["status"] == 0, found["iterations"], iterate, found["seconds"])

    def _describe(self, folder: str, start: Array, guess: Iterate, rounds: int) -> dict[str, Any]:
        task = self._task
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
            "start": start.tolist(),
            "x": guess.x.tolist(),
            "a": guess.a.tolist(),
            "lower": task.lower_x.tolist(),
            "upper": task.upper_x.tolist(),
            "acceleration": task.acceleration.tolist(),
            "torque": task.torque.tolist(),
            "rounds": rounds,
        }
