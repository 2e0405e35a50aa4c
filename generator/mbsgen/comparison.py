"""An imported robot compared with Pinocchio's model of the same URDF file: Phi, M, c and qdd at random states.

Pinocchio's recursions ignore damping, friction and rotors; our equations include them. So everything is compared twice:
as imported, and without these. Joints are matched by name; differences in their order are listed. For coupled joints,
Pinocchio's uncoupled model is projected, because its reader refuses some couplings. Loops are compared at closed states
(`closed_comparison`).
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsgen.assembly import AssemblyError, assemble
from mbsgen.closed_comparison import RESULTS as CLOSED_RESULTS
from mbsgen.closed_comparison import Joints, compute_ours, compute_theirs, draw_states, find_uncompared
from mbsgen.errors import Fault, InputError
from mbsgen.formulations.catalogue import FUNCTIONS, REFERENCE, list_giving
from mbsgen.formulations.reductions import ALL
from mbsgen.importing import Choices, import_model
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.symbols import to_double
from mbsgen.model.tree import NO_FORCE, ZERO, Tree
from mbsgen.procedure.procedure import straight
from mbsgen.roles import Role
from mbsgen.tape.interpreter import evaluate
from mbsgen.tape.types import Tape

Array = NDArray[np.float64]
STATES = 5
TOLERANCE = 1e-9  # relative: some thousand roundings, and the effect of rounded angles in the file
SMALL = 1e-6  # smaller values may be the rounding of 0
RESULTS = ("Phi", "M", "c", "qdd")


@dataclass(frozen=True)
class Comparison:
    """The largest differences, relative to the largest entry of each result."""

    imported: Mapping[str, float]  # with everything in the file
    bare: Mapping[str, float]  # without damping, friction and rotors
    named: tuple[str, ...]  # the known differences, in words
    lost: float  # by solving for qdd: epsilon times the condition of M
    closed: Mapping[str, float] = field(default_factory=dict)  # with loops, at closed states, without joint forces
    lost_closed: float = 0.0  # by solving for qdd there

    @property
    def agrees(self) -> bool:
        """Return whether only the known differences remain."""
        is_good = all(miss <= max(TOLERANCE, self.lost if name == "qdd" else 0.0) for name, miss in self.bare.items())
        return is_good and all(miss <= max(TOLERANCE, self.lost_closed) for miss in self.closed.values())


def compare_with_pinocchio(path: Path, choices: Choices) -> Comparison:
    """Import a URDF file, with and without joint forces, and compare. Raises InputError where this is impossible."""
    if choices.base == "floating":
        choices = replace(choices, quaternions=True)  # Pinocchio's coordinates of a free body
    imported = import_model(path, choices)
    closed = build_tree(imported.model)
    tree = replace(closed, loops=(), constraints=())
    peer = _Peer(path, choices, tree)
    bare = _strip(tree)
    states = [peer.draw(seed) for seed in range(STATES)]
    expected = [peer.compute(*state) for state in states]
    found, without = (_compute(t, states) for t in (tree, bare))
    lost = float(np.finfo(float).eps * max(np.linalg.cond(x["M"]) for x in expected))
    loops = _Loops.take(closed)
    named = [*loops.name(), *_name(tree, bare, peer)]
    if loops.tree is None:
        return Comparison(_miss(found, expected), _miss(without, expected), tuple(named), lost)
    misses, lost_closed = _compare_closed(loops.tree, peer)
    return Comparison(_miss(found, expected), _miss(without, expected), tuple(named), lost, misses, lost_closed)


class _Peer:
    """Pinocchio's model of the file, with its joints in our order."""

    def __init__(self, path: Path, choices: Choices, tree: Tree) -> None:
        try:
            self.pin: Any = importlib.import_module("pinocchio")
        except ImportError:
            raise _refuse(path, "Pinocchio is not installed", "`pip install pin`, and compare again") from None
        root = [self.pin.JointModelFreeFlyer()] if choices.base == "floating" else []
        model = self.pin.buildModelFromUrdf(str(path), *root)
        held = [name for name in model.names[1:] if name not in _names(tree) and name != "root_joint"]
        moving = [name for name in held if model.nvs[model.getJointId(name)] > 0]
        if moving:
            model = self._hold(model, moving, choices)
        self.model, self.data = model, model.createData()
        self.free = 6 if root else 0
        names = [body.joint.name for body in tree.bodies[self.free :]]
        missing = [name for name in names if not model.existJointName(name)]
        if missing or model.nv != len(tree.bodies):
            shown = ", ".join(missing[:4]) or f"{model.nv} velocities there, {len(tree.bodies)} here"
            finding = f"Pinocchio has other joints: {shown}"
            raise _refuse(path, finding, "compare robots whose joints turn about or slide along single axes")
        places = [int(model.idx_vs[model.getJointId(name)]) for name in names]
        self.order = np.array([*range(self.free), *places])
        self.size, self.names = len(tree.joints), names
        self.G, self.g = _map_couplings(tree)

    def _hold(self, model: Any, moving: Sequence[str], choices: Choices) -> Any:
        at = self.pin.neutral(model)
        for name in moving:
            at[model.idx_qs[model.getJointId(name)]] = dict(choices.locked).get(name, 0.0)
        return self.pin.buildReducedModel(model, [model.getJointId(name) for name in moving], at)

    def draw(self, seed: int) -> tuple[Array, Array, Array]:
        """Draw q, qd and qdd in our order; a free base comes first, with its position and its quaternion."""
        rng = np.random.default_rng(seed)
        q = rng.uniform(-1, 1, self.size + (1 if self.free else 0))
        if self.free:
            q[3:7] /= np.linalg.norm(q[3:7])
        return q, rng.uniform(-1, 1, self.size), rng.uniform(-1, 1, self.size)

    def place(self, q: Array) -> Array:
        """Return Pinocchio's coordinates."""
        model, pin = self.model, self.pin
        angles, first = np.zeros(model.nv), 7 if self.free else 0
        angles[self.order] = self.G @ np.concatenate((np.zeros(self.free), q[first:])) + self.g
        at: Array = pin.integrate(model, pin.neutral(model), angles)  # for a joint without limits, cosine and sine
        if self.free:
            at[:7] = q[:7]
        return at

    def compute(self, q: Array, qd: Array, qdd: Array) -> dict[str, Array]:
        """Compute all results without joint forces, in our order."""
        model, data, pin, at = self.model, self.data, self.pin, self.place(q)
        v, a = np.zeros(model.nv), np.zeros(model.nv)
        v[self.order], a[self.order] = self.G @ qd, self.G @ qdd
        Phi = self.G.T @ np.array(pin.rnea(model, data, at, v, a))[self.order]
        c = self.G.T @ np.array(pin.rnea(model, data, at, v, 0 * a))[self.order]
        upper = np.triu(np.array(pin.crba(model, data, at)))
        M = self.G.T @ (upper + np.triu(upper, 1).T)[np.ix_(self.order, self.order)] @ self.G
        return {"Phi": Phi, "M": M, "c": c, "qdd": np.linalg.solve(M, -c)}


def _map_couplings(tree: Tree) -> tuple[Array, Array]:
    """Return G and g of q = G y + g, with y the independent coordinates."""
    rules = {x.follower: x for x in tree.couplings}
    kept = [i for i in range(1, len(tree.bodies) + 1) if i not in rules]
    G, g = np.zeros((len(tree.bodies), len(kept))), np.zeros(len(tree.bodies))
    for i in range(1, len(tree.bodies) + 1):
        if i in rules:
            g[i - 1] = to_double(rules[i].offset)
            for leader, ratio in rules[i].terms:
                G[i - 1, kept.index(leader)] = to_double(ratio)
        else:
            G[i - 1, kept.index(i)] = 1.0
    return G, g


def _refuse(path: Path, finding: str, remedy: str) -> InputError:
    return InputError([Fault(str(path), 0, "", finding, remedy)])


def _names(tree: Tree) -> set[str]:
    return {body.joint.name for body in tree.bodies}


def _strip(tree: Tree) -> Tree:
    """Remove force laws and rotors of joints."""
    joints = (replace(body.joint, law=NO_FORCE, armature=ZERO) for body in tree.bodies)
    return replace(tree, bodies=tuple(replace(b, joint=j) for b, j in zip(tree.bodies, joints, strict=True)))


def _compute(tree: Tree, states: Sequence[tuple[Array, Array, Array]]) -> list[dict[str, Array]]:
    """Compute Phi, M, c and qdd by the kernels of the tree, without inputs."""
    tapes = [
        straight(FUNCTIONS[name].build(tree, replace(ALL, trials=1)))
        for name in (REFERENCE, list_giving(Role.MASS_MATRIX)[0], list_giving(Role.ACCELERATION)[0])
    ]
    rest = np.zeros(sum(joint.actuated for joint in tree.joints))
    results: list[dict[str, Array]] = []
    for q, qd, qdd in states:
        given = {"q": q, "qd": qd, "qdd": qdd, "u": rest}
        results.append({name: value for tape in tapes for name, value in evaluate_tape(tape, given).items()})
    return results


def evaluate_tape(tape: Tape, given: Mapping[str, Array]) -> dict[str, Array]:
    """Evaluate a tape at the values of its inputs."""
    values = evaluate(tape, {i.name: list(given[i.name]) for i in tape.inputs})
    found = {}
    for o in tape.outputs:
        full = np.zeros((o.sparsity.rows, o.sparsity.cols))
        for place, value in zip(o.sparsity.entries, values[o.name], strict=True):
            full[place] = value
        found[o.name] = full[:, 0] if o.sparsity.cols == 1 and o.name != "M" else full
    return found


def _compare_closed(tree: Tree, peer: _Peer) -> tuple[dict[str, float], float]:
    """Compare forces of loops and accelerations at closed states; return also the digits that solving loses."""
    bare, states = _strip(tree), draw_states(tree)
    found, expected, lost = compute_ours(bare, states, evaluate_tape), [], 0.0
    for q, qd in states:
        open_tree = peer.compute(q, qd, np.zeros_like(qd))
        joints = Joints(peer.pin, peer.model, peer.data, peer.order, peer.G, peer.free)
        joints.move(peer.place(q), qd)
        expected.append(compute_theirs(tree, joints, (q, qd), open_tree["M"], open_tree["c"]))
        lost = max(lost, float(np.finfo(float).eps * np.linalg.cond(open_tree["M"])))
    misses = _miss(found, expected, CLOSED_RESULTS[1:])
    speed = max(float(np.abs(qd).max(initial=0.0)) for _, qd in states)
    rates = max(float(theirs["rates"].max(initial=0.0)) for theirs in expected)
    return {"rates": rates / max(SMALL, speed), **misses}, lost


def _miss(
    found: Sequence[Mapping[str, Array]], expected: Sequence[Mapping[str, Array]], results: Sequence[str] = RESULTS
) -> dict[str, float]:
    return {
        name: max(
            float(np.abs(ours[name] - theirs[name]).max() / max(SMALL, np.abs(theirs[name]).max()))
            for ours, theirs in zip(found, expected, strict=True)
        )
        for name in results
    }


@dataclass(frozen=True)
class _Loops:
    """The loops of a tree, with the assembled tree, or the reason why they are not compared."""

    names: tuple[str, ...]
    tree: Tree | None = None
    reason: str = ""

    @classmethod
    def take(cls, tree: Tree) -> _Loops:
        names = (*(loop.name for loop in tree.loops), *(constraint.name for constraint in tree.constraints))
        if not names:
            return cls(())
        if other := find_uncompared(tree):
            return cls(names, reason=f"{_list(other)} keeps quantities that are not compared")
        try:
            return cls(names, assemble(tree))
        except AssemblyError as error:
            return cls(names, reason=error.findings[0].finding)

    def name(self) -> Iterator[str]:
        """Name what is compared."""
        if self.names:
            what = f"loops and constraints {_list(self.names)}: Pinocchio's reader has none"
            rest = "they are closed beside its model" if self.tree else f"the trees are compared alone: {self.reason}"
            yield f"{what}; {rest}"


def _name(tree: Tree, bare: Tree, peer: _Peer) -> Iterator[str]:
    forced = [a.joint.name for a, b in zip(tree.bodies, bare.bodies, strict=True) if a.joint.law != b.joint.law]
    driven = [
        a.joint.name for a, b in zip(tree.bodies, bare.bodies, strict=True) if a.joint.armature != b.joint.armature
    ]
    if forced:
        yield f"damping and friction of {_list(forced)}: in our equations, not in Pinocchio's"
    if driven:
        yield f"armature of {_list(driven)}: in our equations; of Pinocchio, set model.armature"
    if list(peer.order) != sorted(peer.order):
        theirs = [name for _, name in sorted(zip(peer.order[peer.free :], peer.names, strict=True))]
        yield f"order of joints: Pinocchio's is {_list(theirs)}; ours is {_list(peer.names)}"


def _list(names: Sequence[str]) -> str:
    return ", ".join(names[:12]) + (f" and {len(names) - 12} more" if len(names) > 12 else "")
