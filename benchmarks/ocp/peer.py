"""The peer: the same optimal control problem in plain CasADi, as its users write it.

The equations of motion are short recursions in SX, mapped over the collocation points; CasADi differentiates the whole,
and runs it in its virtual machine, or as C that it writes. It takes only the values of a problem and a guess from
`mbsrun`, and computes its points and weights itself.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmarks.compilation import EXPORTED, run
from benchmarks.newton_euler import write_functions
from mbsgen.manifest import Kernel, Manifest
from mbsgen.model.tree import Tree
from mbsrun.library import find_compiler
from mbsrun.ocp.ground.plant import Plant, Unchangeable
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.problem.problem import Problem

Array = NDArray[np.float64]

FLAGS = ["-O3", "-march=native", "-ffp-contract=fast", "-fno-math-errno", *EXPORTED]


@dataclass(frozen=True)
class Effort:
    """The effort of a solve, in processor time."""

    status: str
    iterations: int
    cost: float
    cpu_seconds: float
    cpu_seconds_evaluating: float


def processor_seconds() -> float:
    """Return the processor time spent so far, with compilers."""
    return sum(os.times()[:4])


@dataclass(frozen=True)
class Shelf:
    """Libraries of C that CasADi wrote, found again by compiler and text; beside each, what compiling it took."""

    folder: Path

    def compile(self, source: Path) -> tuple[Path, float]:
        """Return the library of a C file, and the processor time that compiling took whenever that was."""
        command = (*find_compiler(os.environ).command, *FLAGS, "-fPIC", "-shared")
        version = run((command[0], "--version"))
        digest = hashlib.sha256(repr((command, version)).encode() + source.read_bytes()).hexdigest()[:16]
        library, record = self.folder / f"peer-{digest}.so", self.folder / f"peer-{digest}.json"
        if not library.exists():
            self.folder.mkdir(parents=True, exist_ok=True)
            unfinished = library.with_suffix(f".{os.getpid()}")
            begin = processor_seconds()
            run((*command, str(source), "-o", str(unfinished), "-lm"))
            record.write_text(json.dumps({"seconds": processor_seconds() - begin}) + "\n", "utf-8")
            unfinished.replace(library)
        return library, float(json.loads(record.read_text("utf-8"))["seconds"])


class Peer:
    """A transcribed problem."""

    def __init__(
        self,
        problem: Problem,
        dynamics: Mapping[str, ca.Function],
        place: ca.Function,
        settings: Settings,
        shelf: Shelf | None = None,
    ) -> None:
        """Write the program, and make IPOPT for it; `place` gives the position of the sensor that has a target.

        With a shelf, what CasADi makes of the program is compiled, derivatives and all.
        """
        begin = processor_seconds()
        self.problem = problem
        representation, N, d = problem.representation, problem.intervals, problem.degree
        n, m, h = len(problem.start_q), len(problem.bounds.u), problem.horizon / problem.intervals
        points_of_scheme = ca.collocation_points(d, problem.family.value)
        C, D, _ = (ca.sparsify(c, 1e-12) for c in ca.collocation_coeff(points_of_scheme))  # Radau's D is 1 at the end
        has_z = not representation.is_ode
        at_point = (3 if has_z else 2) * n
        v, last = ca.MX.sym("v", 2 * n + d * at_point + m, N), ca.MX.sym("last", 2 * n)  # a column for each interval
        mesh, u = ca.horzcat(v[: 2 * n, :], last), v[-m:, :]
        points = ca.reshape(v[2 * n : -m, :], at_point, N * d)
        X, U = points[: 2 * n, :], ca.reshape(ca.repmat(u, d, 1), m, N * d)
        kernel = dynamics[{"IMPL": "impl", "SEMI": "semi"}.get(representation.value, "exp")]
        q, qd, z = X[:n, :], X[n:, :], points[2 * n :, :]
        values = kernel.map(N * d)(*((q, qd, U) if representation.is_explicit else (q, qd, z, U)))
        Z = z if has_z else values
        residual = (Z - values if representation.is_explicit else values) if has_z else ca.MX(0, N * d)
        slopes = ca.vertcat(qd, Z)
        nodes = [mesh[:, :N], *(X[:, j::d] for j in range(d))]

        def combine(weights: ca.DM) -> ca.MX:
            return sum((weights[r] * nodes[r] for r in weights.row()), start=ca.MX(2 * n, N))

        rows = []
        for j in range(d):
            rows += [combine(C[:, j]) - h * slopes[:, j::d], residual[:, j::d]]
        g = [mesh[:, 0] - np.array(problem.start_q + problem.start_qd)]
        g.append(ca.vec(ca.vertcat(*rows, combine(D) - mesh[:, 1:])))
        end_q, end_qd = last[:n], last[n:]
        target = np.array(problem.end.sensors[0][1])
        # Radau's last point is the end
        end_z = z[:, -1] if has_z else dynamics["exp"](end_q, end_qd, u[:, -1])
        g += [place(end_q) - target, end_qd, end_z]
        inputs_cost = h * ca.sumsqr(u)
        rates_cost = ca.sumsqr(u[:, 1:] - u[:, :-1]) / h
        nlp: dict[str, Any] = {
            "x": ca.vertcat(ca.vec(v), last),
            "f": problem.cost.inputs * inputs_cost + problem.cost.input_rates * rates_cost,
            "g": ca.vertcat(*g),
        }
        options = list_options(settings, shelf)
        self._solver = ca.nlpsol("peer", "ipopt", nlp, options)
        states, free = np.array(problem.bounds.q + problem.bounds.qd), np.tile((-np.inf, np.inf), (n, 1))
        point = np.concatenate((states, free)) if has_z else states
        column = np.concatenate((states, *[point] * d, np.array(problem.bounds.u).reshape(-1, 2)))
        self._lower, self._upper = np.concatenate((*[column] * N, states)).T
        self.variables, self.constraints = int(nlp["x"].numel()), int(nlp["g"].numel())
        self.jacobian_nonzeros = int(self._solver.get_function("nlp_jac_g").nnz_out(1))
        self.seconds_building = processor_seconds() - begin
        if shelf is not None:
            self._solver, seconds = compile_solver(self._solver, options, shelf)
            self.seconds_building += seconds

    def solve(self, guess: Trajectory) -> Effort:
        """Solve from a guess."""
        begin = time.process_time()
        answer = self._solver(x0=self._pack(guess), lbx=self._lower, ubx=self._upper, lbg=0, ubg=0)
        seconds, statistics = time.process_time() - begin, self._solver.stats()
        evaluating = sum(value for key, value in statistics.items() if key.startswith("t_proc_nlp_"))
        cost = float(answer["f"])
        return Effort(statistics["return_status"], statistics["iter_count"], cost, seconds, evaluating)

    def _pack(self, guess: Trajectory) -> Array:
        parts = [guess.q[0], guess.qd[0]]
        for k in range(self.problem.intervals):
            for j in range(self.problem.degree):
                parts += [guess.point_q[k, j], guess.point_qd[k, j]]
                if not self.problem.representation.is_ode:
                    parts.append(guess.point_qdd[k, j])
            parts += [guess.u[k], guess.q[k + 1], guess.qd[k + 1]]
        return np.concatenate(parts)


def compile_solver(solver: ca.Function, options: Mapping[str, Any], shelf: Shelf) -> tuple[ca.Function, float]:
    """Return the same solver with its functions compiled, and the processor time that takes."""
    begin = processor_seconds()
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):  # CasADi writes to where it is
        solver.generate_dependencies("peer.c")
        seconds_writing = processor_seconds() - begin
        library, seconds = shelf.compile(Path("peer.c"))
    compiled = {key: value for key, value in options.items() if key != "expand"}
    return ca.nlpsol("peer", "ipopt", str(library), compiled), seconds_writing + seconds


class Points(Unchangeable):
    """The kernels of a model; the dynamics are C that CasADi writes of other equations and their derivatives.

    A program that is assembled from derivatives at points, as in `mbsrun.ocp`, uses them instead of the generated ones.
    """

    def __init__(self, plant: Plant, functions: Mapping[str, ca.Function], shelf: Shelf) -> None:
        """Take generated kernels, for all else, and functions by the kernels' names."""
        self._plant, self._functions, self._shelf = plant, functions, shelf
        self.seconds_compiling = 0.0

    @property
    def manifest(self) -> Manifest:
        """Describe the kernels."""
        return self._plant.manifest

    def describe(self, name: str) -> Kernel:
        """Describe a generated kernel."""
        return self._plant.describe(name)

    def __call__(self, name: str, /, *, sparse: bool = False, **inputs: ArrayLike) -> dict[str, Array]:
        """Evaluate a generated kernel."""
        return self._plant(name, sparse=sparse, **inputs)

    def find_family(self, name: str) -> Points:
        """Return the kernels that hold a function with all of its derivatives: these."""
        self.describe(name)
        return self

    def casadi(self, name: str, *, design: bool = False) -> ca.Function:
        """Return a kernel as a CasADi function with its derivatives; design: `theta` is an input."""
        if name not in self._functions:
            return self._plant.casadi(name, design=design)
        function = _eliminate(self._functions[name], f"peer_{name}")
        adjoint = function.reverse(1)
        with tempfile.TemporaryDirectory() as folder:
            generator = ca.CodeGenerator("points.c")
            for each in (function, function.jacobian(), adjoint, adjoint.jacobian()):
                generator.add(_eliminate(each, each.name()))
            generator.generate(f"{folder}/")
            library, seconds = self._shelf.compile(Path(folder) / "points.c")
        self.seconds_compiling += seconds
        return ca.external(function.name(), str(library))


def _eliminate(function: ca.Function, name: str) -> ca.Function:
    """Return a function without common subexpressions, under another name."""
    inputs = function.sx_in()
    return ca.Function(name, inputs, function.call(inputs), function.name_in(), function.name_out(), {"cse": True})


def write_dynamics(tree: Tree) -> dict[str, ca.Function]:
    """Return impl, semi (M qdd + c - Q) and exp of short recursions, without common subexpressions."""
    functions = write_functions(tree, ("impl", "exp1"))
    impl, exp = functions["impl"], functions["exp1"]
    q, qd, qdd, u = (ca.SX.sym(impl.name_in(i), impl.size1_in(i)) for i in range(4))
    M = ca.jacobian(impl(q, qd, qdd, u), qdd)
    semi = M @ qdd + impl(q, qd, ca.SX(qdd.numel(), 1), u)
    options = {"cse": True}
    return {
        "impl": ca.Function("impl", [q, qd, qdd, u], [impl(q, qd, qdd, u)], options),
        "semi": ca.Function("semi", [q, qd, qdd, u], [semi], options),
        "exp": ca.Function("exp", [q, qd, u], [exp(q, qd, u)], options),
    }


TUNED = ("tuned", "tuned, adaptive")  # settings of compiled peers


@dataclass(frozen=True)
class Settings:
    """Options of CasADi and IPOPT."""

    ipopt: Mapping[str, Any]
    expand: bool  # whether the whole program becomes one expression of scalars, where it is not compiled


def list_options(settings: Settings, shelf: Shelf | None) -> dict[str, Any]:
    """List the options of a peer's solver; sensitivities to parameters would be compiled too, for nobody."""
    return {
        "print_time": False,
        "error_on_fail": False,
        "no_nlp_grad": True,
        "calc_lam_p": False,
        "expand": settings.expand and shelf is None,
        "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-8, **settings.ipopt},
    }


def list_settings(problem: Problem) -> dict[str, Settings]:
    """Return settings by name: the defaults, the fastest that were found, and these with an adaptive barrier."""
    scale = 1 / max(problem.cost.inputs, problem.cost.input_rates)
    mumps = {"mumps_pivot_order": 0, "mumps_scaling": 0, "mumps_permuting_scaling": 0}
    tuned = {"nlp_scaling_method": "none", "obj_scaling_factor": scale, **mumps}
    adaptive = {**tuned, "mu_strategy": "adaptive"}
    return {
        "defaults": Settings({}, False),
        "tuned": Settings(tuned, True),
        "tuned, adaptive": Settings(adaptive, True),
    }
