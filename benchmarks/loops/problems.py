"""The motions of the loop benchmarks: what starts how, how long it runs, and where it then is.

References are the files of `tests/reference` that `python -m tests.loop_references` writes. The error of a motion is
the largest of |x - x*| / (1 + |x*|) over the coordinates and velocities of its joints at its end, as the mixed error of
the Test Set for IVP Solvers; of 3-D bodies in absolute coordinates, over places and velocities of centres of mass.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.loops.mechanism import Law, Spring, release
from benchmarks.loops.models import find_model
from mbsgen.model.tree import Tree
from mbsgen.pipeline import read_tree

Array = NDArray[np.float64]

REFERENCES = Path(__file__).parents[2] / "tests" / "reference"


@dataclass(frozen=True)
class Problem:
    """A motion, and its end."""

    name: str
    title: str
    span: float
    tree: Tree  # as the peers have it, without laws of joints
    q: Array  # at first, of the peers' tree
    qd: Array
    end: Array  # q and qd at the end
    laws: tuple[Law, ...] = ()
    springs: tuple[Spring, ...] = ()  # instead of laws that are not constant, for peers that have springs
    is_stiff: bool = False
    is_redundant: bool = False
    file: Path | None = None  # our model file, if it is none of the loops'

    @property
    def model(self) -> Path:
        """Return our model file."""
        return self.file or find_model(self.name)

    @property
    def start(self) -> tuple[Array, Array]:
        """Return our start: the coordinates and velocities of all joints."""
        n = 0 if self.file else len(_read(self.name).bodies) - len(self.q)
        return np.concatenate([self.q, np.full(n, 0.5)]), np.concatenate([self.qd, np.zeros(n)])

    def measure(self, q: Array, qd: Array) -> float:
        """Return the error of a state; joints that the peers lack are left out."""
        n = len(self.q)
        return measure_error(np.concatenate([q[:n], qd[:n]]), self.end)


def measure_error(found: Array, expected: Array) -> float:
    """Return the largest mixed error; infinity for numbers that are not finite."""
    error = float((np.abs(found - expected) / (1 + np.abs(expected))).max())
    return error if np.isfinite(error) else float("inf")


@cache
def _read(name: str) -> Tree:
    return read_tree(find_model(name))


def _refer(name: str) -> Mapping[str, Any]:
    content: Mapping[str, Any] = json.loads((REFERENCES / f"{name}.json").read_text("utf-8"))
    return content


def _pose(tree: Tree) -> Array:
    assert tree.closure is not None, "the benchmarks have loops"
    return np.array(tree.closure.pose)


def make_andrews() -> Problem:
    """Return Andrews' mechanism, for 0.05 s."""
    tree, reference = _read("andrews"), _refer("loops_andrews")
    end = reference["motion"]["0.05"]
    places = [reference["order"].index(body.joint.name) for body in tree.bodies]
    state = np.array([float(end[part][k]) for part in ("angles", "rates") for k in places])
    x = {parameter.name: parameter.value for parameter in tree.parameters}
    spring = Law(2, k=x["stiffness"], slack=x["slack"], a=x["a"], b=x["b"], rest=x["rest"])
    tie = Spring((3, 0), ((x["sd"], -x["sc"], 0.0), (x["xc"], x["yc"], 0.0)), x["stiffness"], 0.0, x["slack"])
    laws = (Law(0, f=x["torque"]), spring)
    return Problem("andrews", "Andrews, 0.05 s", 0.05, release(tree), _pose(tree), np.zeros(7), state, laws, (tie,))


def make_bricard() -> Problem:
    """Return Bricard's mechanism, for 10 s."""
    tree, end = _read("bricard"), _refer("loops_bricard")["motion"]["10"]
    rows = ([float(x) for x in end[part]] for part in ("angles", "rates"))
    state = np.array([pair[k % 2] for pair in rows for k in range(5)])
    zero = np.zeros(5)
    return Problem("bricard", "Bricard, 10 s", 10.0, release(tree), zero, zero, state, is_redundant=True)


def make_four_bars() -> Problem:
    """Return two four-bars, for 10 s: through singular poses."""
    tree, end = _read("four_bars"), _refer("loops_four_bars")["motion"]["2"]["10"]
    tilt, rate = (-float(x) for x in end["angle"])
    state = np.concatenate([_lean(tilt), _lean(rate)])
    return Problem("four_bars", "two four-bars, 10 s", 10.0, release(tree), np.zeros(5), _lean(-1.0), state)


def _lean(angle: float) -> Array:
    """Return the angles of the joints for an angle of the upright rods: a0, b1, a1, b2, a2."""
    return np.array([angle, -angle, angle, -angle, angle])


def make_flyball() -> Problem:
    """Return the governor, for 10 s; the peers have springs where we have struts."""
    whole, end = _read("flyball"), _refer("loops_flyball")["motion"]["10"]["state"]
    s, sd, alpha, alphad, turn = map(float, end)
    tree = replace(release(whole), bodies=release(whole).bodies[:4], constraints=(), closure=None, chosen=(), rough=())
    x = {parameter.name: parameter.value for parameter in whole.parameters}
    springs = tuple(
        Spring(
            (2, rod),
            ((side * x["side"] / 2, 0.0, 0.0), (side * x["l"] / 2, 0.0, 0.0)),
            x["stiffness"],
            x["damping"],
            0.5,
        )
        for rod, side in ((3, 1), (4, -1))
    )
    omega = _find_omega(alpha)
    state = np.array([turn, s, alpha, alpha, omega, sd, alphad, alphad])
    start, rates = np.array([0.0, 0.5, np.pi / 6, np.pi / 6]), np.array([2 * np.pi, 0.0, 0.0, 0.0])
    return Problem("flyball", "flyball governor, 10 s", 10.0, tree, start, rates, state, (), springs, is_stiff=True)


def _find_omega(alpha: float) -> float:
    """Return the shaft's speed, by its angular momentum."""

    def spin(angle: float) -> float:
        c, s, long, thin = np.cos(angle), np.sin(angle), 0.3 * 1.0001 / 12, 0.3e-4 / 6
        rods = long * c**2 + thin * s**2 + 0.3 * (0.05 + c / 2) ** 2 + 5 * (0.05 + c) ** 2
        return float(thin + 3 * 0.01 / 6 + 2 * rods)

    return 2 * np.pi * spin(np.pi / 6) / spin(alpha)


PROBLEMS: Mapping[str, Callable[[], Problem]] = {
    "andrews": make_andrews,
    "bricard": make_bricard,
    "four_bars": make_four_bars,
    "flyball": make_flyball,
}
