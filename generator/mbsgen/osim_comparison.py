"""An imported model of OpenSim compared with OpenSim: masses, forces, places, and lengths at random states.

Free joints of the model move at random. Followers and explicit equations give all others; along z + zd t + zdd t^2/2 of
the free joints their rates are differences in 60 digits. Coordinates of the file follow from joints. OpenSim's speeds
of balls and free joints are angular velocities in the parent's frame. Both sides are projected on the free joints.
Moment arms are, with the other sign, the rates of a length where one free joint moves at the speed 1. Around
ellipsoids and tori, OpenSim's rates are not derivatives of its lengths: differences of lengths are compared, and the
rates are shown beside them.

OpenSim runs in another process, by the Python that MBSGEN_OPENSIM names, or by this one.
"""

from __future__ import annotations

import json
import operator
import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from mpmath import mp, mpf
from numpy.typing import NDArray

from mbsgen.comparison import evaluate_tape
from mbsgen.errors import Fault, InputError
from mbsgen.expressions import FLOATS, Algebra, Number, evaluate, find_first_name, names, substitute
from mbsgen.formulations.catalogue import FUNCTIONS, REFERENCE, list_giving
from mbsgen.formulations.reductions import ALL
from mbsgen.importing import Choices, Imported, import_model
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.following import list_joints
from mbsgen.model.model import Wrench
from mbsgen.procedure.procedure import straight
from mbsgen.roles import Role
from mbsgen.tape.types import Tape

Array = NDArray[np.float64]
VARIABLE = "MBSGEN_OPENSIM"
STATES = 5
TOLERANCE = 1e-8  # relative to the largest number of a kind: digits that a knee's splines lose in sums of cubes
AROUND = " around cylinders"  # OpenSim's lines are not the shortest there, if the cylinder is oblique
SHAPED = " around ellipsoids and tori"
PULLS = f"OpenSim's own arms{SHAPED}"  # not of its lengths: known to differ
NEAR = 1e-2  # relative: for lines around these surfaces
REACH = 0.9  # rad or m, of random coordinates
RESULTS = ("M", "tau", "places", "lengths", "rates", "arms")
TIME = 600.0  # s
_MASS = list_giving(Role.MASS_MATRIX)[0]
_DIGITS, _STEP = 60, "1e-15"
_PRECISE: Algebra[mpf] = Algebra(
    number=mpf,
    constants={"pi": mp.pi},
    negate=operator.neg,
    operations={"+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv},
    power=operator.pow,
    functions={"max": max, "min": min, "sin": mp.sin, "abs": abs},
)


@dataclass(frozen=True)
class State:
    """A state of the tree's joints, and of the file's coordinates as OpenSim has them."""

    q: Array
    qd: Array
    qdd: Array
    slopes: Array  # of q by the free joints
    given: Mapping[str, Mapping[str, float]]
    theirs: Array  # derivatives of the file's coordinates by the free joints, with OpenSim's speeds
    signals: Mapping[str, float]  # of all forces that are no muscles


Ask = Callable[[Path, Sequence[State]], Any]  # the answer of the script


@dataclass(frozen=True)
class OpenSimComparison:
    """The largest differences, relative to the largest number of a kind, and what was compared."""

    misses: Mapping[str, float]  # without what a model does not have
    lines: tuple[str, ...]  # names of muscles and springs
    absent: tuple[str, ...]  # muscles and springs that are not in the model

    @property
    def agrees(self) -> bool:
        """Return whether nothing differs by more than the tolerance."""
        judged = {key: miss for key, miss in self.misses.items() if key != PULLS}
        return all(miss <= (NEAR if key.endswith((AROUND, SHAPED)) else TOLERANCE) for key, miss in judged.items())


def compare_with_opensim(
    path: Path, choices: Choices, ask: Ask | None = None, count: int = STATES
) -> OpenSimComparison:
    """Import a file of OpenSim, and compare with its answers at some states. Raises InputError where there are none."""
    ask = ask_opensim if ask is None else ask
    seen = import_model(path, choices)
    imported = import_model(path, replace(choices, sensors=seen.visible))
    motion = _Motion(imported)
    states = [motion.draw(np.random.default_rng(seed)) for seed in range(count)]
    answer = ask(path, states)
    motion.let_act(answer.get("acting", ()))
    elements = motion.elements
    misses: dict[str, float] = {}
    for state, result in zip(states, answer["states"], strict=True):
        for key, (ours, theirs) in motion.compare(state, answer["names"], result).items():
            miss = float(np.abs(ours - theirs).max(initial=0.0) / max(np.abs(theirs).max(initial=0.0), 1e-6))
            misses[key] = max(misses.get(key, 0.0), miss)
    absent = tuple(name for name in answer["states"][0]["paths"] if name not in elements)
    return OpenSimComparison(misses, elements, absent)


class _Motion:
    """The joints of an imported model as functions of its free ones."""

    def __init__(self, imported: Imported) -> None:
        self.imported = imported
        model = imported.model
        self._joints = {step.name: step.joint for step in list_joints(model)}
        explicit = {
            first: x.equation for x in model.constraints if (first := find_first_name(x.equation)) in self._joints
        }
        self._equations = explicit
        self.free = [x for x, joint in self._joints.items() if joint.follows is None and x not in explicit]
        opened = replace(model, constraints=(), loops=(), independent=(), assembly=())
        self._opened, self.tree = opened, build_tree(opened)
        self._bare = self.tree
        followers = {name for name, joint in self._joints.items() if joint.follows is not None}
        self.order = [body.joint.name for body in self.tree.bodies if body.joint.name not in followers]
        self.elements = self.tree.elements
        self._kinds = {x.name: {wrap.kind for wrap in x.wraps} for x in model.forces}
        self._tapes: dict[str, Tape] = {}
        reads: dict[str, set[str]] = {}
        for name, read in [
            *((x.name, x.reads) for x in model.forces if x.muscle is None),
            *((x.name, find_names(x)) for x in model.wrenches),
        ]:
            reads.setdefault(imported.labels[name], set()).update(read)
        self._driven = {name: own for name, x in reads.items() if (own := [s for s in model.signals if s in x])}
        self.signals = [*dict.fromkeys(signal for own in self._driven.values() for signal in own)]

    def let_act(self, acting: Sequence[str]) -> None:
        """Take only these lines of the file for inverse dynamics."""
        label = self.imported.labels
        kept = tuple(x for x in self._opened.forces if label[x.name] in acting)
        pushes = tuple(x for x in self._opened.wrenches if label[x.name] in acting)
        self._bare = build_tree(replace(self._opened, forces=kept, wrenches=pushes))

    def draw(self, rng: np.random.Generator) -> State:
        """Draw a state."""
        zd, zdd = rng.uniform(-REACH, REACH, (2, len(self.free)))
        z = rng.uniform(*np.array([self._limit(name) for name in self.free]).reshape(-1, 2).T)
        ours = self._follow(z, zd, zdd, lambda at: [self._find(name, at) for name in self.order])
        theirs = self._follow(z, zd, zdd, self._list_coordinates)
        unit, none = np.eye(len(z)), np.zeros(len(z))
        slopes, others = (
            np.array([self._follow(z, row, none, read)[1] for row in unit]).T
            for read in (lambda at: [self._find(name, at) for name in self.order], self._list_coordinates)
        )
        E, Ed = self._spin(*theirs[:2])
        labels = [x.name for x in self.imported.coordinates]
        rows = {"q": theirs[0], "u": E @ theirs[1], "udot": E @ theirs[2] + Ed @ theirs[1]}
        given: dict[str, Any] = {key: dict(zip(labels, map(float, row), strict=True)) for key, row in rows.items()}
        others = E @ others
        drawn = dict(zip(self.signals, rng.uniform(-1, 1, len(self.signals)).tolist(), strict=True))
        given["controls"] = {name: [drawn[x] for x in read] for name, read in self._driven.items()}
        given["along"] = [dict(zip(labels, map(float, column), strict=True)) for column in others.T]
        return State(*ours, slopes, given, others, drawn)

    def _limit(self, name: str) -> tuple[float, float]:
        """Return the bounds of a free joint's random coordinates: within its range, if it has one."""
        joint = self._joints[name]
        lower, upper = (
            bound if x is None else evaluate(x, {}, FLOATS)
            for x, bound in ((joint.lower, -REACH), (joint.upper, REACH))
        )
        low, high = max(lower, -REACH), min(upper, REACH)
        return (low, high) if low < high else (lower, upper)

    def compare(self, state: State, labels: Sequence[str], result: Mapping[str, Any]) -> dict[str, tuple[Array, Array]]:
        """Return pairs of our numbers and OpenSim's."""
        own = [labels.index(x.name) for x in self.imported.coordinates]
        w = np.array([state.signals.get(name, 0.0) for name in self._bare.signals])
        at = {"q": state.q, "qd": state.qd, "qdd": state.qdd}
        M, tau = np.array(result["M"])[np.ix_(own, own)], np.array(result["tau"])[own]
        found = {
            "M": (
                state.slopes.T @ self._compute(self._tape(_MASS), at)["M"] @ state.slopes,
                state.theirs.T @ M @ state.theirs,
            ),
            "tau": (state.slopes.T @ self._compute(self._tape(REFERENCE), {**at, "w": w})["Phi"], state.theirs.T @ tau),
        }
        frames = self.imported.model.frames
        if frames:
            places = {**result["bodies"], **result["markers"]}
            wanted = np.array([places[self.imported.labels[frame.name]] for frame in frames])
            found["places"] = self._compute(self._tape("sensors"), at)["position"].reshape(-1), wanted.T.reshape(-1)
        known = [k for k, name in enumerate(self.elements) if self.imported.labels[name] in result["paths"]]
        if known:
            paths = [result["paths"][self.imported.labels[self.elements[k]]] for k in known]
            rates = self._tape("stretches")
            slopes = [self._compute(rates, {**at, "qd": column})["stretch"] for column in state.slopes.T]
            numbers = {
                "lengths": (self._compute(self._tape("lengths"), at)["length"][known], [x["length"] for x in paths]),
                "rates": (self._compute(rates, at)["stretch"][known], [x["rate"] for x in paths]),
                "arms": (-np.array(slopes).T[known], [[-y for y in x["slopes"]] for x in paths]),
            }
            for key, (ours, theirs) in numbers.items():
                endings = [self._find_ending(self.elements[k]) for k in known]
                for ending in sorted({*endings} - ({SHAPED} if key == "rates" else set())):
                    chosen = [k for k, x in enumerate(endings) if x == ending]
                    wanted = np.array([theirs[k] for k in chosen])
                    if key == "arms" and ending == SHAPED:
                        found[PULLS] = ours[chosen], wanted
                        wanted = -np.array([paths[k]["changes"] for k in chosen])
                    found[key + ending] = ours[chosen], wanted
        return found

    def _find_ending(self, name: str) -> str:
        """Return what is said of the surfaces around which a line wraps."""
        kinds = self._kinds.get(name, set())
        if not kinds.isdisjoint(("ellipsoid", "torus")):
            return SHAPED
        return AROUND if "cylinder" in kinds else ""

    def _tape(self, name: str) -> Tape:
        if name not in self._tapes:
            self._tapes[name] = self._build(name)
        return self._tapes[name]

    def _build(self, name: str) -> Tape:
        tree = self._bare if name in (_MASS, REFERENCE) else self.tree
        return straight(FUNCTIONS[name].build(tree, replace(ALL, trials=1)))

    def _compute(self, tape: Tape, given: Mapping[str, Array]) -> dict[str, Array]:
        """Evaluate a function at a state; signals and inputs are 0."""
        return evaluate_tape(tape, {i.name: given.get(i.name, np.zeros(i.sparsity.nnz)) for i in tape.inputs})

    def _find(self, name: str, z: Mapping[str, mpf]) -> mpf:
        """Return the coordinate of a joint."""
        if name in z:
            return z[name]
        if name in self._equations:
            rest = substitute(self._equations[name], {name: Number(0.0)})
            return -evaluate(rest, {x: self._find(x, z) for x in names(rest)}, _PRECISE)
        follows = self._joints[name].follows
        assert follows is not None, "a joint is free, follows, or has an equation"
        ratio, offset = (evaluate(x, {}, _PRECISE) for x in (follows.ratio, follows.offset))
        return ratio * self._find(follows.joint, z) + offset

    def _list_coordinates(self, z: Mapping[str, mpf]) -> list[mpf]:
        return [
            mpf(x.offset) + (mpf(x.ratio) * self._find(x.joint, z) if x.joint else mpf(0))
            for x in self.imported.coordinates
        ]

    def _follow(
        self, z: Array, zd: Array, zdd: Array, read: Callable[[Mapping[str, mpf]], list[mpf]]
    ) -> tuple[Array, Array, Array]:
        """Return numbers that the free joints give, with two time derivatives."""
        with mp.workdps(_DIGITS):
            h = mpf(_STEP)

            def at(t: mpf) -> list[mpf]:
                rows = zip(self.free, z, zd, zdd, strict=True)
                return read({name: mpf(a) + mpf(b) * t + mpf(c) * t * t / 2 for name, a, b, c in rows})

            back, here, on = at(-h), at(mpf(0)), at(h)
            first = [(b - a) / (2 * h) for a, b in zip(back, on, strict=True)]
            second = [(a - 2 * b + c) / h**2 for a, b, c in zip(back, here, on, strict=True)]
            value, rate, change = (np.array([float(x) for x in row]) for row in (here, first, second))
            return value, rate, change

    def _spin(self, q: Array, qd: Array) -> tuple[Array, Array]:
        """Return the matrix of angular velocities by the rates of angles about x, y, z in turn, and its derivative."""
        labels = [x.name for x in self.imported.coordinates]
        E, Ed = np.eye(len(q)), np.zeros((len(q), len(q)))
        for turns in self.imported.balls:
            own = [labels.index(name) for name in turns]
            (a, b, _), (ad, bd, _) = q[own], qd[own]
            sa, ca, sb, cb = np.sin(a), np.cos(a), np.sin(b), np.cos(b)
            E[np.ix_(own, own)] = [[1, 0, sb], [0, ca, -sa * cb], [0, sa, ca * cb]]
            Ed[np.ix_(own, own)] = [
                [0, 0, cb * bd],
                [0, -sa * ad, -ca * cb * ad + sa * sb * bd],
                [0, ca * ad, -sa * cb * ad - ca * sb * bd],
            ]
        return E, Ed


def find_names(wrench: Wrench) -> set[str]:
    """Return the names that a wrench reads."""
    return {name for vector in (wrench.force, wrench.moment) for x in vector or () for name in names(x)}


def ask_opensim(path: Path, states: Sequence[State]) -> Any:
    """Run OpenSim on a file. Raises InputError where there is none, or where it fails."""
    python = os.environ.get(VARIABLE, sys.executable)
    script = Path(__file__).with_name("opensim_script.py")
    text = json.dumps({"file": str(path.resolve()), "states": [x.given for x in states]})
    try:
        run = subprocess.run(
            [python, str(script)],
            input=text,
            capture_output=True,
            text=True,
            timeout=TIME + len(states),
            check=False,
            cwd=path.parent,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise _refuse(path, f"{python} does not run OpenSim: {error}") from None
    if run.returncode:
        last = (run.stderr.strip().splitlines() or ["no message"])[-1]
        missing = "No module named 'opensim'" in run.stderr
        raise _refuse(path, "OpenSim is not installed" if missing else f"OpenSim fails: {last[:200]}")
    return json.loads(run.stdout.splitlines()[-1])


def _refuse(path: Path, finding: str) -> InputError:
    remedy = f"let {VARIABLE} name a Python in which `pip install opensim` was run, and compare again"
    return InputError([Fault(str(path), 0, "", finding, remedy)])
