"""Work and precision: the time of the processor that programs take for a motion, by the error at its end.

Each program integrates with its own methods and a row of accuracies or steps; Pinocchio, which has none, with DOP853 in
C++, without projection. Models are read and built before the clock starts.
"""

from __future__ import annotations

import ctypes
import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.integrate._ivp import dop853_coefficients as dop853

from benchmarks.loops.mechanism import find_massless, write_loops, write_xml
from benchmarks.loops.peers import (
    DIRECT,
    MUJOCO,
    PINOCCHIO,
    PROGRAMS,
    PROXIMAL,
    SIMTK,
    compile_mujoco,
    compile_pinocchio,
    compile_simbody,
)
from benchmarks.loops.placement import place_bodies
from benchmarks.loops.problems import Problem, measure_error
from mbsrun.limits import LimitError

Array = NDArray[np.float64]

EXUDYN = "Exudyn"
LEVELS = (1e-3, 1e-5, 1e-7, 1e-9, 1e-11)
SHORT = 0.1  # s: longer runs are not repeated
LONG = 1.0  # s: after a longer run, what is more exact is not tried


@dataclass(frozen=True)
class Run:
    """One motion."""

    error: float
    seconds: float  # of the processor
    steps: int


@dataclass(frozen=True)
class Way:
    """A program's method with a row of settings, from coarse to fine."""

    author: str
    method: str
    runs: tuple[Callable[[], Run], ...]


@dataclass(frozen=True)
class Point:
    """A setting: its error, its shortest time and its median."""

    author: str
    method: str
    error: float
    seconds: float
    seconds_median: float
    steps: int
    rounds: int


@dataclass(frozen=True)
class Diagram:
    """All points of a problem."""

    problem: str
    title: str
    points: tuple[Point, ...]
    load: tuple[float, float]  # of the machine, before and after

    def find_best(self, author: str, level: float) -> Point | None:
        """Return an author's quickest point with at most an error."""
        able = [x for x in self.points if x.author == author and x.error <= level]
        return min(able, key=lambda x: x.seconds, default=None)


def measure_problem(problem: Problem, ways: Sequence[Way], rounds: int, report: Callable[[str], None]) -> Diagram:
    """Run all ways; a run that fails has no point, and a way ends at its first run that is long."""
    before, points = os.getloadavg()[0], []
    for way in ways:
        for run in way.runs:
            report(f"{problem.title}: {way.author}, {way.method}")
            try:
                runs = [run()]
                while len(runs) < rounds and runs[0].seconds < SHORT:
                    runs.append(run())
            except ArithmeticError:
                continue
            except LimitError:
                break
            seconds = [x.seconds for x in runs]
            best, median = min(seconds), float(np.median(seconds))
            points.append(Point(way.author, way.method, runs[0].error, best, median, runs[0].steps, len(runs)))
            if best > LONG:
                break
    return Diagram(problem.name, problem.title, tuple(points), (before, os.getloadavg()[0]))


def list_peers(problem: Problem, folder: Path) -> Iterator[Way]:
    """List the ways of all peers that are installed."""
    springs = problem.springs if not problem.laws else ()
    (folder / "mechanism.txt").write_text(write_loops(problem.tree, problem.laws, springs), encoding="utf-8")
    yield from _list_simbody(problem, folder)
    if problem.is_stiff:
        yield from _list_exudyn(problem)
        return
    yield from _list_pinocchio(problem, folder)
    yield from _list_exudyn(problem)
    yield from _list_mujoco(problem, folder)


# --- Simbody ------------------------------------------------------------------------------------------------------

INTEGRATORS = ("Runge-Kutta-Merson", "Runge-Kutta-Feldberg", "CPodes, BDF")


def _list_simbody(problem: Problem, folder: Path) -> Iterator[Way]:
    library = compile_simbody()
    if library is None:
        return
    opened = ctypes.CDLL(str(library))

    def solve(kind: int, accuracy: float) -> Run:
        if opened.sbl_load(os.fsencode(folder / "mechanism.txt")):
            raise ArithmeticError("Simbody cannot read the mechanism")
        q, qd, seconds, counts = problem.q.copy(), problem.qd.copy(), ctypes.c_double(), (ctypes.c_longlong * 2)()
        numbers = [ctypes.c_double(x) for x in (accuracy, max(0.1 * accuracy, 1e-12), problem.span)]
        if opened.sbl_simulate(kind, *numbers, _point(q), _point(qd), ctypes.byref(seconds), counts):
            raise ArithmeticError("Simbody did not reach the end")
        return Run(problem.measure(q, qd), seconds.value, counts[0])

    for kind in (2,) if problem.is_stiff else (0, 1):
        accuracies = tuple(10.0**-k for k in range(2, 13))
        yield Way(SIMTK, INTEGRATORS[kind], tuple(_bind(solve, kind, x) for x in accuracies))


# --- Pinocchio ----------------------------------------------------------------------------------------------------


def _list_pinocchio(problem: Problem, folder: Path) -> Iterator[Way]:
    library = compile_pinocchio(PROGRAMS[1])
    if library is None:
        return
    opened, stages = ctypes.CDLL(str(library)), dop853.N_STAGES
    A = np.ascontiguousarray(dop853.A[:stages, :stages])
    b, e3, e5 = (np.ascontiguousarray(x, dtype=float) for x in (dop853.B, dop853.E3, dop853.E5))

    def solve(settings: tuple[float, float, int], tolerance: float) -> Run:
        mu, accuracy, iterations = settings
        q, qd, seconds, calls = problem.q.copy(), problem.qd.copy(), ctypes.c_double(), ctypes.c_longlong()
        if opened.pinm_simulate(
            os.fsencode(folder / "mechanism.txt"),
            *(ctypes.c_double(x) for x in (mu, accuracy)),
            iterations,
            stages,
            *map(_point, (A, b, e3, e5)),
            *(ctypes.c_double(x) for x in (problem.span, tolerance)),
            _point(q),
            _point(qd),
            ctypes.byref(seconds),
            ctypes.byref(calls),
        ):
            raise ArithmeticError("Pinocchio did not reach the end")
        return Run(problem.measure(q, qd), seconds.value, calls.value)

    tolerances = tuple(10.0**-k for k in range(2, 15))
    ways = (("direct", DIRECT), ("proximal", PROXIMAL)) if problem.tree.loops else (("articulated bodies", DIRECT),)
    for label, settings in ways:
        yield Way(PINOCCHIO, f"DOP853, {label}", tuple(_bind(solve, settings, x) for x in tolerances))


# --- Exudyn -------------------------------------------------------------------------------------------------------


def _list_exudyn(problem: Problem) -> Iterator[Way]:
    if find_spec("exudyn") is None:
        return
    from benchmarks.loops.exudyn_models import Manner, Plane, Space, is_flat

    flat = is_flat(problem.tree)
    if not flat and not problem.tree.loops and not problem.springs:
        return  # places of centres of mass do not say how a top turns

    def solve(steps: int, trapezoidal: bool) -> Run:
        manner = Manner(steps, trapezoidal, is_redundant=problem.is_redundant)
        if flat:
            plane = Plane(problem.tree, problem.q.tolist(), problem.qd.tolist(), problem.laws, problem.springs)
            end = plane.run(problem.span, manner)
            q, qd = (_relate(problem, values) for values in (end.angle, end.omega))
            return Run(problem.measure(q, qd), end.seconds, steps)
        end = Space(problem.tree, problem.q.tolist(), problem.qd.tolist(), problem.springs).run(problem.span, manner)
        n = len(problem.q)
        places = place_bodies(problem.tree, problem.end[:n].tolist(), problem.end[n:].tolist())[1:]
        expected = np.array([[*x.com, *x.velocity] for x in places])
        return Run(measure_error(np.hstack([end.position, end.velocity]), expected), end.seconds, steps)

    counts = (500, 2000, 8000, 32000) if flat else (500, 2000, 8000)
    for label, trapezoidal in (("generalised alpha, index 3", False), ("trapezoidal, index 2", True)):
        yield Way(EXUDYN, label, tuple(_bind(solve, n, trapezoidal) for n in counts))


def _relate(problem: Problem, values: Array) -> Array:
    """Return values of joints from values of bodies in the plane."""
    whole = np.concatenate([[0.0], values])
    return np.array([whole[k + 1] - whole[body.parent] for k, body in enumerate(problem.tree.bodies)])


# --- MuJoCo -------------------------------------------------------------------------------------------------------


def _list_mujoco(problem: Problem, folder: Path) -> Iterator[Way]:
    library = compile_mujoco()
    if library is None or find_massless(problem.tree):
        return
    opened, path = ctypes.CDLL(str(library)), folder / "motion.xml"
    path.write_text(write_xml(problem.tree, problem.springs), encoding="utf-8")
    forces = np.zeros(len(problem.q))
    for law in problem.laws:
        forces[law.joint] = law.f

    def solve(integrator: int, steps: int) -> Run:
        if opened.mjl_load(os.fsencode(path), (ctypes.c_int * 1)(), 0):
            raise ArithmeticError("MuJoCo cannot read the mechanism")
        q, qd, seconds = problem.q.copy(), problem.qd.copy(), ctypes.c_double()
        step, count = ctypes.c_double(problem.span / steps), ctypes.c_longlong(steps)
        opened.mjl_simulate(integrator, step, count, _point(forces), _point(q), _point(qd), ctypes.byref(seconds))
        return Run(problem.measure(q, qd), seconds.value, steps)

    counts, soft = (100, 300, 1000, 4000, 16000, 64000), ", soft" if problem.tree.loops else ""
    for integrator, label in ((1, f"Runge-Kutta 4{soft}"), (3, f"implicit{soft}")):
        yield Way(MUJOCO, label, tuple(_bind(solve, integrator, n) for n in counts))


def _point(array: Array) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def _bind(solve: Callable[..., Run], *settings: object) -> Callable[[], Run]:
    return lambda: solve(*settings)


def measure_motion(problem: Problem, ours: Sequence[Way], rounds: int, report: Callable[[str], None]) -> Diagram:
    """Run our ways and the ways of all peers."""
    with tempfile.TemporaryDirectory() as place:
        return measure_problem(problem, [*ours, *list_peers(problem, Path(place))], rounds, report)
