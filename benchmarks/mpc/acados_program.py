"""Solve tasks by acados, in its environment: `python acados_program.py task.json`; a request a line, an answer a line.

acados writes its solver around placeholders of the constraint functions; the C files of `folder` replace these before
it is compiled. They call the generated kernels, which `libraries` hold. The file holds the numbers of a task, too.
acados prints to stdout, so answers go to a copy of it, and its own lines to stderr.

Requests have `settings`, the entries of `acados_peer.Settings`, and

    prepare   a start, a guess, and whether it shifts: starts from the multipliers of the last solution that did not
    solve     from there: status, iterations, processor time, states, accelerations
    differentiate   the last solution: the first accelerations by the first state, in rows, and processor time
    control   steps in real time from a solution: the times of preparation and feedback, and the last state
"""

from __future__ import annotations

import ctypes
import json
import os
import shutil
import sys
import time
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from acados_template import AcadosModel, AcadosOcp, AcadosOcpSolver

NAME = "panda"
PREPARATION, FEEDBACK = 1, 2
Numbers = dict[str, Any]


def make_ocp(task: Numbers, settings: Numbers) -> AcadosOcp:
    """State the task; the torques are a placeholder."""
    A, B = np.array(task["A"]), np.array(task["B"])
    n, m = B.shape
    model = AcadosModel()
    model.name = NAME
    model.x, model.u = ca.SX.sym("x", n), ca.SX.sym("u", m)
    model.disc_dyn_expr = A @ model.x + B @ model.u
    model.con_h_expr = model.u * model.x[:m] * model.x[m:]
    ocp = AcadosOcp()
    ocp.model = model
    ocp.dims.N = task["N"]
    ocp.cost.cost_type = ocp.cost.cost_type_e = "LINEAR_LS"
    ocp.cost.Vx, ocp.cost.Vu, ocp.cost.Vx_e = np.eye(n + m, n), np.eye(n + m, m, -n), np.eye(n)
    ocp.cost.W, ocp.cost.W_e = np.diag(task["W"]), np.diag(task["E"])  # acados multiplies W by the step
    ocp.cost.yref, ocp.cost.yref_e = np.append(task["goal"], np.zeros(m)), np.array(task["goal"])
    constraints = ocp.constraints
    constraints.x0 = np.zeros(n)
    constraints.lbu, constraints.ubu = -np.array(task["acceleration"]), np.array(task["acceleration"])
    constraints.idxbu = np.arange(m)
    constraints.lbx = constraints.lbx_e = np.array(task["lower"])
    constraints.ubx = constraints.ubx_e = np.array(task["upper"])
    constraints.idxbx = constraints.idxbx_e = np.arange(n)
    constraints.lh, constraints.uh = -np.array(task["torque"]), np.array(task["torque"])
    options = ocp.solver_options
    options.tf = task["N"] * task["step"]
    options.integrator_type = "DISCRETE"
    options.qp_solver = "PARTIAL_CONDENSING_HPIPM"
    options.qp_solver_iter_max = 100
    options.hessian_approx = "GAUSS_NEWTON"
    options.nlp_solver_type = settings["method"]
    options.nlp_solver_max_iter = 50
    options.hpipm_mode = settings["mode"]
    options.qp_solver_ric_alg = settings["riccati"]
    options.qp_solver_cond_N = settings["blocks"]
    options.tol = options.qp_tol = settings["tolerance"]
    return ocp


class Session:
    """A task, and the solvers that were built for it, by the settings that are compiled in."""

    def __init__(self, task: Numbers) -> None:
        """Take a task."""
        self._task = task
        self._solvers: dict[str, AcadosOcpSolver] = {}
        self._point: Numbers = {}
        self._kept: dict[str, list[Any]] = {}  # multipliers of a solution,
        self._multipliers: dict[str, list[Any]] = {}  # and those to start from

    def _find(self, settings: Numbers) -> AcadosOcpSolver:
        """Return the solver with the settings: built where it is not, its other options set."""
        key = "_".join(str(settings[name]) for name in ("method", "mode", "riccati", "blocks"))
        if key not in self._solvers:
            self._solvers[key] = self._build(key, settings)
        solver = self._solvers[key]
        for part in ("stat", "eq", "ineq", "comp"):
            if settings["method"] == "SQP":
                solver.options_set(f"tol_{part}", settings["tolerance"])
            solver.options_set(f"qp_tol_{part}", settings["precision"] * settings["tolerance"])
        solver.options_set("qp_warm_start", settings["warm"])
        solver.options_set("warm_start_first_qp", int(settings["warm"] > 0))
        return solver

    def _build(self, key: str, settings: Numbers) -> AcadosOcpSolver:
        """Generate, put the kernels in, compile and load."""
        place = Path(self._task["folder"]) / key
        ocp = make_ocp(self._task, settings)
        ocp.code_export_directory = str(place)
        description = f"{place}.json"
        AcadosOcpSolver.generate(ocp, json_file=description)
        for file in Path(self._task["folder"]).glob(f"{NAME}_constr_h_*.c"):
            shutil.copy(file, place / f"{NAME}_constraints")
        AcadosOcpSolver.build(str(place), with_cython=False)
        return AcadosOcpSolver(ocp, json_file=description, build=False, generate=False)

    def prepare(self, request: Numbers) -> Numbers:
        """Keep where solves begin; multipliers are the kept ones, moved a step ahead, or zero."""
        self._point, self._multipliers = request, {}
        if request["shifts"]:
            pi, lam = self._kept["pi"], self._kept["lam"]
            self._multipliers = {"pi": [*pi[1:], pi[-1]], "lam": [*lam[1:-1], *lam[-2:]]}  # the end has fewer bounds
        return {}

    def solve(self, request: Numbers) -> Numbers:
        """Solve once from the kept point; the solution's multipliers are kept for the next one."""
        solver = self._lay(request["settings"])
        begin = time.process_time()
        status = solver.solve()
        seconds = time.process_time() - begin
        N = self._task["N"]
        if not self._point["shifts"] and not status:
            self._kept = {
                "pi": [solver.get(k, "pi") for k in range(N)],
                "lam": [solver.get(k, "lam") for k in range(N + 1)],
            }
        return {
            "status": int(status),
            "iterations": int(np.max(solver.get_stats("sqp_iter"))),
            "seconds": seconds,
            "x": [solver.get(k, "x").tolist() for k in range(N + 1)],
            "a": [solver.get(k, "u").tolist() for k in range(N)],
        }

    def differentiate(self, request: Numbers) -> Numbers:
        """Differentiate the last solution by the first state."""
        solver, columns, seconds = self._find(request["settings"]), [], 0.0
        for j in range(len(self._task["goal"])):
            begin = time.process_time()
            solver.eval_param_sens(j)
            seconds += time.process_time() - begin
            columns.append(solver.get(0, "sens_u"))
        return {"slopes": np.stack(columns, axis=1).tolist(), "seconds": seconds}

    def _lay(self, settings: Numbers) -> AcadosOcpSolver:
        """Set bounds, guess and multipliers."""
        solver, N, point = self._find(settings), self._task["N"], self._point
        solver.reset()
        for k in range(N + 1):
            solver.set(k, "x", np.array(point["x"][k]))
            if k < N:
                solver.set(k, "u", np.array(point["a"][k]))
        if settings["multipliers"] == "kept":
            for name, values in self._multipliers.items():
                for k, value in enumerate(values):
                    solver.set(k, name, value)
        for bound in ("lbx", "ubx"):
            solver.set(0, bound, np.array(point["start"]))
        return solver

    def control(self, request: Numbers) -> Numbers:
        """Converge from the kept point, then move the robot in real time: one quadratic program a period."""
        solver = self._lay(request["settings"])
        A, B = np.array(self._task["A"]), np.array(self._task["B"])
        solver.options_set("rti_phase", 0)
        for _ in range(20):
            status = solver.solve()
        x, times, path = np.array(self._point["start"]), [], []
        for k in range(request["steps"]):
            if k and request["settings"]["multipliers"] == "kept":
                self._shift(solver)
            solver.options_set("rti_phase", PREPARATION)
            begin = time.perf_counter()
            prepared = solver.solve()
            prepare = time.perf_counter() - begin
            for bound in ("lbx", "ubx"):
                solver.set(0, bound, x)
            solver.options_set("rti_phase", FEEDBACK)
            begin = time.perf_counter()
            status = solver.solve()
            times.append((prepare, time.perf_counter() - begin))
            if prepared or status:
                break
            a = solver.get(0, "u")
            path.append([*x.tolist(), *a.tolist()])
            x = A @ x + B @ a
        return {"status": int(status), "times": times, "path": path, "end": x.tolist()}

    def _shift(self, solver: AcadosOcpSolver) -> None:
        """Move the iterate a step ahead; the last part stays."""
        N = self._task["N"]
        for k in range(N):
            solver.set(k, "x", solver.get(k + 1, "x"))
            if k < N - 1:
                for name in ("u", "pi", "lam"):
                    solver.set(k, name, solver.get(k + 1, name))


def main(path: str) -> None:
    """Answer requests until there are no more."""
    task = json.loads(Path(path).read_text("utf-8"))
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    for library in task["libraries"]:
        ctypes.CDLL(library, mode=ctypes.RTLD_GLOBAL)
    os.chdir(task["folder"])
    session = Session(task)
    with os.fdopen(os.dup(1), "w", encoding="utf-8") as answers:
        os.dup2(2, 1)
        for line in sys.stdin:
            request = json.loads(line)
            print(json.dumps(getattr(session, request["do"])(request)), file=answers, flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
