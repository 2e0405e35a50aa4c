"""Solve a task by acados, in its environment: `python acados_program.py task.json`; JSON to the last line.

acados writes its solver around placeholders of the constraint functions; the C files of `folder` replace these before
it is compiled. They call the generated kernels, which `libraries` hold. The file holds the numbers of a task, too.
"""

from __future__ import annotations

import ctypes
import json
import os
import shutil
import sys
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from acados_template import AcadosModel, AcadosOcp, AcadosOcpSolver

NAME = "panda"


def make_ocp(task: dict[str, Any], method: str) -> AcadosOcp:
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
    constraints.x0 = np.array(task["start"])
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
    options.hessian_approx = "GAUSS_NEWTON"
    options.nlp_solver_type = method
    options.nlp_solver_max_iter = 200
    options.tol = 1e-8
    options.qp_tol = 1e-9
    return ocp


def build(task: dict[str, Any], method: str) -> AcadosOcpSolver:
    """Generate, put the kernels in, compile and load."""
    place = Path(task["folder"]) / method
    ocp = make_ocp(task, method)
    ocp.code_export_directory = str(place)
    description = str(Path(task["folder"]) / f"{method}.json")
    AcadosOcpSolver.generate(ocp, json_file=description)
    for file in Path(task["folder"]).glob(f"{NAME}_constr_h_*.c"):
        shutil.copy(file, place / f"{NAME}_constraints")
    AcadosOcpSolver.build(str(place), with_cython=False)
    return AcadosOcpSolver(ocp, json_file=description, build=False, generate=False)


def solve(solver: AcadosOcpSolver, task: dict[str, Any]) -> dict[str, Any]:
    """Solve from the guess; multipliers start at zero."""
    N = task["N"]
    solver.reset()
    for k in range(N + 1):
        solver.set(k, "x", np.array(task["x"][k]))
        if k < N:
            solver.set(k, "u", np.array(task["a"][k]))
    for bound in ("lbx", "ubx"):
        solver.set(0, bound, np.array(task["start"]))
    status = solver.solve()
    return {
        "status": int(status),
        "iterations": int(np.max(solver.get_stats("sqp_iter"))),
        "seconds": float(np.max(solver.get_stats("time_tot"))),
        "x": [solver.get(k, "x").tolist() for k in range(N + 1)],
        "a": [solver.get(k, "u").tolist() for k in range(N)],
    }


def main(path: str) -> None:
    """Solve the task of a file several times, and print the quickest answer."""
    task = json.loads(Path(path).read_text("utf-8"))
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    for library in task["libraries"]:
        ctypes.CDLL(library, mode=ctypes.RTLD_GLOBAL)
    os.chdir(task["folder"])
    solver = build(task, "SQP")
    answers = [solve(solver, task) for _ in range(task["rounds"])]
    print()
    print(json.dumps(min(answers, key=lambda answer: answer["seconds"])))


if __name__ == "__main__":
    main(sys.argv[1])
