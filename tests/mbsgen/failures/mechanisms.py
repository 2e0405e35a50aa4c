"""Mechanisms on which formulations lose digits, and what their tapes give in float64, in float32 and in 50 digits."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from sympy import Expr, Float, Integer, Rational

from mbsgen.formulations import condition, exp1, exp2, impl, semi
from mbsgen.formulations.reductions import NONE, Reductions
from mbsgen.model.tree import Body, Joint, Matrix, Motion, Tree, Vector
from mbsgen.tape.interpreter import DIGITS, FLOATS, Numbers, evaluate, find_failure
from mbsgen.tape.types import Tape
from tests.random_trees import exact_matrix

Array = NDArray[np.float64]
Build = Callable[[Tree, Reductions], Tape]
U = 2.0**-53  # half the distance from 1 to the next double: what one rounding loses
EXPLICIT = ("exp1", "exp2")
RESIDUALS = ("impl", "semi_res")
REDUCED = Reductions(trials=1)  # of the sensible plans, the cheapest; others do not change what is computed
LARGE = 50  # bodies
REDUCTIONS = {"reduced": REDUCED, "textbook": NONE}
FLOATS64 = replace(FLOATS, literal=np.float64)  # unlike Python's floats, they divide by 0 as C does
FLOATS32 = Numbers(np.float32, FLOATS.functions, np.float32(2.0**-23))

_ZERO, _ONE = Integer(0), Integer(1)
_DOWN = (_ZERO, Float(-9.81), _ZERO)
NOWHERE: Vector = (_ZERO, _ZERO, _ZERO)
NOTHING: Matrix = (NOWHERE, NOWHERE, NOWHERE)
UPRIGHT: Matrix = ((_ONE, _ZERO, _ZERO), (_ZERO, _ONE, _ZERO), (_ZERO, _ZERO, _ONE))
_BUILDS: Mapping[str, Build] = {
    "impl": impl.build,
    "semi": semi.build,
    "semi_res": semi.build_residual,
    "exp1": exp1.build,
    "exp2": exp2.build,
    "condition": condition.build,
}


@cache
def tape_of(name: str, tree: Tree, reductions: Reductions = REDUCED) -> Tape:
    """Write a formulation of a tree; of a large one with its sums as they come, which takes half the time."""
    return _BUILDS[name](tree, replace(reductions, factor=reductions.factor and len(tree.bodies) < LARGE))


# -- mechanisms ---------------------------------------------------------------------------------------------------


def diagonal(xx: Expr, yy: Expr, zz: Expr) -> Matrix:
    """Make the inertia of a body with three planes of symmetry."""
    return ((xx, _ZERO, _ZERO), (_ZERO, yy, _ZERO), (_ZERO, _ZERO, zz))


def numbers(*values: float) -> Vector:
    """Take three floats into SymPy."""
    x, y, z = (Float(value) if value else _ZERO for value in values)
    return x, y, z


def make_body(
    number: int,
    axis: int,
    mass: Expr = _ZERO,
    com: Vector = NOWHERE,
    inertia: Matrix = NOTHING,
    *,
    position: Vector = NOWHERE,
    motion: Motion = Motion.REVOLUTE,
) -> Body:
    """Make a body of a chain, with an actuated joint."""
    joint = Joint(f"q{number}", motion, axis, True, None, None)
    return Body(f"b{number}", number - 1, joint, position, UPRIGHT, mass, com, inertia)


def make_tree(name: str, bodies: Sequence[Body], gravity: Vector = _DOWN) -> Tree:
    """Put bodies into a tree."""
    return Tree(name, gravity, (), tuple(bodies), ())


def rods(axes: Sequence[int], factors: Sequence[Expr | int] = ()) -> Tree:
    """Hang thin rods on each other, of 1 kg and 1 m along x, mass and inertia times a factor each."""
    bodies = []
    for number, axis in enumerate(axes, 1):
        mass = Integer(1) * (factors[number - 1] if factors else 1)
        across = mass / 12
        place = (_ONE if number > 1 else _ZERO, _ZERO, _ZERO)
        inertia = diagonal(across / 100, across, across)
        bodies.append(make_body(number, axis, mass, (Rational(1, 2), _ZERO, _ZERO), inertia, position=place))
    return make_tree("rods", bodies)


def straight_chain(size: int) -> Tree:
    """Hang rods on each other with axes all along z."""
    return rods([2] * size)


def spatial_chain(size: int, factors: Sequence[Expr | int] = ()) -> Tree:
    """Hang rods on each other with axes along z, y, x in turn."""
    return rods([(2, 1, 0)[k % 3] for k in range(size)], factors)


def three_axes(axes: Sequence[int]) -> Tree:
    """Turn one body about three axes through a point; what is between the joints has no mass."""
    body = make_body(3, axes[2], Float(1), numbers(0.1, 0.2, 0.3), diagonal(Float(1), Float(2), Float(3)))
    return make_tree("axes", [make_body(1, axes[0]), make_body(2, axes[1]), body])


def elbow() -> Tree:
    """Hold a point mass by two links without mass, with parallel axes."""
    hand = make_body(2, 2, Float(1), numbers(0.4, 0, 0), position=numbers(0.7, 0, 0))
    return make_tree("elbow", [make_body(1, 2), hand])


# -- what their tapes give ----------------------------------------------------------------------------------------


def draw_state(size: int, seed: int, *, q: Array | None = None) -> dict[str, Array]:
    """Draw angles in (-pi, pi), unless they are given; rates, accelerations and forces in (-1, 1)."""
    rng = np.random.default_rng(seed)
    angles = rng.uniform(-np.pi, np.pi, size)
    rest = {name: rng.uniform(-1, 1, size) for name in ("qd", "qdd", "u")}
    return {"q": angles if q is None else q, **rest}


_exact: dict[tuple[object, ...], tuple[Tape, dict[str, Array]]] = {}  # with the tape, so that no other has its id


def _take(tape: Tape, state: Mapping[str, Array], kind: Numbers) -> dict[str, list[object]]:
    return {i.name: [kind.literal(float(x)) for x in state[i.name]] for i in tape.inputs}


def compute(tape: Tape, state: Mapping[str, Array], kind: Numbers = FLOATS64) -> dict[str, Array]:
    """Evaluate a tape; results are rounded to doubles."""
    with np.errstate(all="ignore"):
        found = evaluate(tape, _take(tape, state, kind), kind)
    return {name: np.array([float(x) for x in values]) for name, values in found.items()}


def compute_exactly(tape: Tape, state: Mapping[str, Array]) -> dict[str, Array]:
    """Evaluate a tape in 50 digits, at the same doubles; once."""
    key = id(tape), *(state[i.name].tobytes() for i in tape.inputs)
    if key not in _exact:
        _exact[key] = tape, compute(tape, state, DIGITS)
    return _exact[key][1]


def status(tape: Tape, state: Mapping[str, Array], kind: Numbers = FLOATS64) -> int:
    """Return the joint that the kernel fails at, or 0."""
    with np.errstate(all="ignore"):
        return find_failure(tape, _take(tape, state, kind), kind)


def relative_error(found: Array, exact: Array) -> float:
    """Compare by the largest entry."""
    return float(np.abs(found - exact).max() / np.abs(exact).max())


def error_of(name: str, tree: Tree, state: Mapping[str, Array], reductions: Reductions = REDUCED) -> float:
    """Compare accelerations in float64 with EXP2's in 50 digits, with which another formulation agrees."""
    exact = compute_exactly(tape_of("exp2", tree), state)["qdd"]
    return relative_error(compute(tape_of(name, tree, reductions), state)["qdd"], exact)


def mass_matrix(tree: Tree, state: Mapping[str, Array]) -> tuple[Array, Array]:
    """Compute M and c, exact to the last digit of a double."""
    n = len(tree.bodies)
    terms = compute_exactly(tape_of("semi", tree), state)
    return terms["M"].reshape(n, n), terms["c"]


def scale_of(tree: Tree, state: Mapping[str, Array], qdd: Array) -> Array:
    """Compute |M| |qdd| + |c| + |u|: what the rows of the equations of motion are sums of."""
    M, c = mass_matrix(tree, state)
    scale: Array = np.abs(M) @ np.abs(qdd) + np.abs(c) + np.abs(state["u"])
    return scale


def scaled_condition(tree: Tree, state: Mapping[str, Array]) -> float:
    """Compute the condition of D^-1/2 M D^-1/2, D the diagonal of M, by an inverse in 50 digits."""
    n, tape = len(tree.bodies), tape_of("semi", tree)
    M = evaluate(tape, _take(tape, state, DIGITS), DIGITS)["M"]
    context = DIGITS.literal(1).context
    scaled = context.matrix(n, n)
    for i in range(n):
        for j in range(n):
            scaled[i, j] = M[i * n + j] / context.sqrt(M[i * n + i] * M[j * n + j])
    norms = [np.linalg.norm(np.array(A.tolist(), dtype=float), 2) for A in (scaled, scaled**-1)]
    return float(norms[0] * norms[1])


APART = replace(REDUCED, share_frames=False)
SIDES = {"cosine": numbers(1, 0, 0), "sine": numbers(0, 1, 0)}


def arm(parallel: int, com: Vector) -> Tree:
    """A turret with links on parallel axes; the last is 1 kg at 1 m, and gravity is 1 m/s2."""
    inertia = diagonal(Float(0.1), Float(0.2), Float(0.3))
    turret = make_body(1, 1, Float(0.5), numbers(0.1, 0, 0.1), inertia)
    place = numbers(0.5, 0, 0)
    links = [make_body(i, 2, Float(0.3), numbers(0.1, 0.2, 0), inertia, position=place) for i in range(2, parallel + 1)]
    last = make_body(parallel + 1, 2, Float(1), com, inertia, position=place)
    return make_tree("arm", [turret, *links, last], numbers(0, -1, 0))


def tilted_axes() -> Tree:
    """The axes of CARDAN in frames that stand askew, in its lock where the second angle is 0."""
    rng, tree = np.random.default_rng(1), three_axes((2, 1, 0))
    first, second = np.linalg.qr(rng.normal(size=(3, 2)))[0].T
    frames = [np.eye(3)]
    for axis, along in ((2, first), (1, second), (0, -first)):
        across = np.cross(along, rng.normal(size=3))
        across /= np.linalg.norm(across)
        frame = np.empty((3, 3))
        frame[:, [axis, (axis + 1) % 3, (axis + 2) % 3]] = np.column_stack((along, across, np.cross(along, across)))
        frames.append(frame)
    turns = [exact_matrix(a.T @ b) for a, b in pairwise(frames)]
    return replace(tree, bodies=tuple(replace(b, orientation=R) for b, R in zip(tree.bodies, turns, strict=True)))


DISTANCES = [10.0**-k for k in range(1, 13)] + [0.0]
CARDAN = three_axes((2, 1, 0))
LOCKS = {  # with the second angle at which the first joint locks
    "Cardan": (CARDAN, np.pi / 2),
    "wrist": (three_axes((2, 1, 2)), 0.0),
    "askew": (tilted_axes(), 0.0),
    "elbow": (elbow(), 0.0),
}


def near_lock(tree: Tree, lock: float, distance: float, seed: int) -> dict[str, Array]:
    state = draw_state(len(tree.bodies), seed)
    state["q"][1] = lock - distance
    return state


LIGHT, HEAVY = Rational(1, 10**12), Integer(10**12)
HARMLESS: dict[str, list[Expr | int]] = {
    "a light tip": [1] * 9 + [LIGHT],
    "a heavy base": [10**8] + [1] * 9,
    "a light base": [Rational(1, 10**8)] + [1] * 9,
    "heavy and light in turn": [HEAVY, 1] * 5,
    "light and heavy in turn": [1, HEAVY] * 5,
}
