"""Motions of an imported model by its file's coordinates, for comparison with OpenSim.

Followers and equations give all joints of the model from its free ones. Along z(t) = z + zd t + zdd t^2/2 of the free
joints this computes the coordinates, speeds and accelerations of all of them, in 60 digits, and projects mass matrix
and forces: M' = J^T M J, tau' = J^T tau. OpenSim's joints have the speeds qd, except balls and free joints: these have
angular velocities, in the parent's frame.
"""

from __future__ import annotations

import json
import operator
import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from mpmath import mp, mpf
from numpy.typing import NDArray

from mbsgen.expressions import Algebra, Expression, Name, Number, evaluate, list_operands, names, substitute
from mbsgen.importing import Imported
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.following import list_joints
from mbsgen.pipeline import write_families
from mbsgen.request import Request
from mbsgen.tape.interpreter import evaluate as run_tape
from tests import peers

Array = NDArray[np.float64]
Values = Mapping[str, mpf]
DIGITS = 60
PRECISE: Algebra[mpf] = Algebra(
    number=mpf,
    constants={"pi": mp.pi},
    negate=operator.neg,
    operations={"+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv},
    power=operator.pow,
    functions={"max": max, "min": min, "sin": mp.sin, "abs": abs},
)


def ask_opensim(file: Path, states: Sequence[Mapping[str, Mapping[str, float]]]) -> dict[str, Any]:
    """Run the peer on a file."""
    script = Path(__file__).with_name("osim_peer.py")
    run = subprocess.run(
        [sys.executable, str(script)],
        input=json.dumps({"file": str(file), "states": states}),
        cwd=file.parent,
        env={**os.environ, "PYTHONPATH": str(peers.FOLDER)},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    found: dict[str, Any] = json.loads(run.stdout.splitlines()[-1])
    return found


class Motion:
    """The joints of an imported model as functions of its free ones."""

    def __init__(self, imported: Imported, fixed: Mapping[str, float], rules: Mapping[str, str] = {}) -> None:
        """Take a model; `fixed` are coordinates of the file that are held, `rules` others that are not in the model."""
        model = imported.model
        self.model = model
        self.fixed = fixed
        self._joints = {step.name: step.joint for step in list_joints(model)}
        self._equations = {_first_name(x.equation): x.equation for x in model.constraints}
        self._rules = rules
        self.free = [x for x, joint in self._joints.items() if joint.follows is None and x not in self._equations]

    def find(self, name: str, z: Values) -> mpf:
        """Return the coordinate of a joint of the model, or of the file."""
        if name in z:
            return z[name]
        if name in self.fixed:
            return mpf(self.fixed[name])
        if name in self._rules:
            return self.find(self._rules[name], z)
        if name in self._equations:
            rest = substitute(self._equations[name], {name: Number(0.0)})
            return -evaluate(rest, {x: self.find(x, z) for x in names(rest)}, PRECISE)
        follows = self._joints[name].follows
        assert follows is not None
        ratio, offset = (evaluate(x, {}, PRECISE) for x in (follows.ratio, follows.offset))
        return ratio * self.find(follows.joint, z) + offset

    def follow(
        self, z: Array, zd: Array, zdd: Array, read: Callable[[Values], list[mpf]]
    ) -> tuple[Array, Array, Array]:
        """Return numbers that the free joints give, with two time derivatives."""
        with mp.workdps(DIGITS):
            h = mpf(10) ** -15

            def at(t: mpf) -> list[mpf]:
                rows = zip(self.free, z, zd, zdd, strict=True)
                return read({name: mpf(a) + mpf(b) * t + mpf(c) * t * t / 2 for name, a, b, c in rows})

            back, here, on = at(-h), at(mpf(0)), at(h)
            first = [(b - a) / (2 * h) for a, b in zip(back, on, strict=True)]
            second = [(a - 2 * b + c) / h**2 for a, b, c in zip(back, here, on, strict=True)]
            value, rate, change = (np.array([float(x) for x in row]) for row in (here, first, second))
            return value, rate, change

    def slopes(self, z: Array, read: Callable[[Values], list[mpf]]) -> Array:
        """Return the derivatives of numbers by the free joints."""
        unit, none = np.eye(len(z)), np.zeros(len(z))
        return np.array([self.follow(z, row, none, read)[1] for row in unit]).T

    @cached_property
    def tapes(self) -> dict[str, Any]:
        """The residual, the mass matrix, and the poses of frames, of the tree without its equations."""
        tree = build_tree(replace(self.model, constraints=(), loops=(), independent=(), assembly=()))
        followers = {name for name, joint in self._joints.items() if joint.follows is not None}
        self.order = [body.joint.name for body in tree.bodies if body.joint.name not in followers]
        functions = ("impl", "semi", *(["sensors"] if self.model.frames else []))
        families = write_families(tree, Request(functions=functions, derivatives=0))
        return {tape.name: tape for family in families for tape in family.tapes}

    def compute(self, function: str, **given: Array) -> dict[str, Array]:
        """Compute a function of the tree."""
        tape = self.tapes[function]
        wanted = {i.name: [*given.get(i.name, np.zeros(i.sparsity.nnz))] for i in tape.inputs}
        values = run_tape(tape, wanted)
        found = {}
        for output in tape.outputs:
            matrix = np.zeros((output.sparsity.rows, output.sparsity.cols))
            for (row, col), value in zip(output.sparsity.entries, values[output.name], strict=True):
                matrix[row, col] = value
            found[output.name] = matrix
        return found


def _first_name(expression: Expression) -> str:
    while not isinstance(expression, Name):
        expression = list_operands(expression)[0]
    return expression.name


@dataclass(frozen=True)
class State:
    """A state in both programs."""

    q: Array
    qd: Array
    qdd: Array
    slopes: Array  # of q by the free joints


def spin(state: State, balls: Sequence[Sequence[int]]) -> State:
    """Put angular velocities in the place of the rates of three angles about x, y and z, each turned."""
    n = len(state.q)
    E, Ed = np.eye(n), np.zeros((n, n))
    for ball in balls:
        a, b, _ = state.q[list(ball)]
        ad, bd, _ = state.qd[list(ball)]
        sa, ca, sb, cb = np.sin(a), np.cos(a), np.sin(b), np.cos(b)
        E[np.ix_(ball, ball)] = [[1, 0, sb], [0, ca, -sa * cb], [0, sa, ca * cb]]
        Ed[np.ix_(ball, ball)] = [
            [0, 0, cb * bd],
            [0, -sa * ad, -ca * cb * ad + sa * sb * bd],
            [0, ca * ad, -sa * cb * ad - ca * sb * bd],
        ]
    return State(state.q, E @ state.qd, E @ state.qdd + Ed @ state.qd, E @ state.slopes)


@dataclass(frozen=True)
class Case:
    """A file, and its coordinates in both programs."""

    file: Path
    coordinates: Sequence[str]
    balls: Sequence[Sequence[str]] = ()
    sizes: Mapping[str, float] = field(default_factory=dict)


def draw(motion: Motion, case: Case, seed: int, count: int = 3) -> list[tuple[State, State]]:
    """Draw states: of the file's coordinates in OpenSim, and of the joints of the model's tree."""
    rng = np.random.default_rng(seed)
    assert motion.tapes
    found = []
    for _ in range(count):
        z, zd, zdd = rng.uniform(-0.9, 0.9, (3, len(motion.free)))

        def read_file(values: Values) -> list[mpf]:
            return [motion.find(name, values) / case.sizes.get(name, 1) for name in case.coordinates]

        def read_tree(values: Values) -> list[mpf]:
            return [motion.find(name, values) for name in motion.order]

        theirs, ours = (
            State(*motion.follow(z, zd, zdd, read), motion.slopes(z, read)) for read in (read_file, read_tree)
        )
        balls = [[case.coordinates.index(name) for name in ball] for ball in case.balls]
        found.append((spin(theirs, balls), ours))
    return found


def list_states(case: Case, drawn: Sequence[tuple[State, State]]) -> list[dict[str, dict[str, float]]]:
    """List the states as the peer reads them."""
    return [
        {
            key: dict(zip(case.coordinates, map(float, row), strict=True))
            for key, row in (("q", theirs.q), ("u", theirs.qd), ("udot", theirs.qdd))
        }
        for theirs, _ in drawn
    ]


def find_misses(motion: Motion, case: Case, drawn: Sequence[tuple[State, State]], answer: Any) -> dict[str, float]:
    """Return the largest differences of M, tau and places, relative to the largest entry."""
    rows = [answer["names"].index(name) for name in case.coordinates]
    misses = {"M": 0.0, "tau": 0.0, "places": 0.0}
    for (theirs, ours), result in zip(drawn, answer["states"], strict=True):
        M, tau = np.array(result["M"])[np.ix_(rows, rows)], np.array(result["tau"])[rows]
        own_M = motion.compute("semi", q=ours.q, qd=ours.qd)["M"]
        own_tau = motion.compute("impl", q=ours.q, qd=ours.qd, qdd=ours.qdd)["Phi"][:, 0]
        places = {**result["markers"], **{name: place for name, (_, place) in result["bodies"].items()}}
        pairs = [
            ("M", theirs.slopes.T @ M @ theirs.slopes, ours.slopes.T @ own_M @ ours.slopes),
            ("tau", theirs.slopes.T @ tau, ours.slopes.T @ own_tau),
        ]
        if motion.model.frames:
            seen = motion.compute("sensors", q=ours.q)
            own = next(x for x in seen.values() if x.size == 3 * len(motion.model.frames))
            pairs.append(("places", np.array([places[frame.name] for frame in motion.model.frames]), own.T))
        for key, first, second in pairs:
            miss = np.abs(first - second).max() / max(np.abs(first).max(), 1e-12)
            misses[key] = max(misses[key], float(miss))
    return misses
