"""Evidence for a scene: the flops that each reduction saves, and the agreement of the rest with the whole model.

The reduced functions are compared with the whole model's at random states, in which locked joints have their locked
coordinates. Gravity and wrenches that a scene leaves out are left out of both. Accelerations are put into the whole
model's residual; its rows of moving joints must then vanish, and the other rows hold the forces that lock the joints.
"""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mbsgen.approximation.choice import Approximation
from mbsgen.assembly import assemble
from mbsgen.families import write_families
from mbsgen.formulations import ports
from mbsgen.formulations.catalogue import FUNCTIONS, REFERENCE
from mbsgen.formulations.reductions import Reductions
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.changes.scene import EVERYTHING, Scene, stage
from mbsgen.model.model import Model
from mbsgen.model.tree import Kind, Tree
from mbsgen.model.valuation import Valuation
from mbsgen.procedure.procedure import straight
from mbsgen.request import Request
from mbsgen.roles import Axis, Role
from mbsgen.scene_tables import Evidence
from mbsgen.tape.counts import count
from mbsgen.tape.interpreter import FLOATS, evaluate
from mbsgen.tape.ports import Port
from mbsgen.tape.types import Tape

POINTS = 3  # random states
_OF_ALL_MASS = (ports.POTENTIAL, ports.CENTRE_OF_MASS)  # results that include bodies at rest
Array = NDArray[np.float64]
State = dict[str, Array]


def gather(model: Model, request: Request, approximation: Approximation | None = None) -> Evidence:
    """Count the flops that each part of a scene saves, and compare the rest with the whole model.

    An approximation is counted last; it brings its own comparison.
    """
    plain, scene = request.values_alone, request.scene
    flops = {title: _count(_build(model, part), replace(plain, scene=part)) for title, part in _steps(scene)}
    if approximation is not None:
        flops[f"below a tolerance of {approximation.tolerance:g}"] = _count(approximation.tree, plain)
    # the whole mechanism is at random states, where loops are open
    is_exact = replace(scene, tolerance=None) == EVERYTHING or bool(model.loops or model.constraints)
    return Evidence(flops, {} if is_exact else _compare(model, plain), approximation)


def _build(model: Model, scene: Scene) -> Tree:
    return assemble(build_tree(stage(model, scene)))


def _steps(scene: Scene) -> Iterator[tuple[str, Scene]]:
    """Apply one part of a scene after the other."""
    present = replace(EVERYTHING, functions=scene.functions, together=scene.together)
    yield "the whole model", present
    for title, names in (
        ("kinds of parameters", ("parameters",)),
        ("joints locked", ("locked",)),
        ("no gravity", ("gravity",)),
        ("no motion", ("motion",)),
        ("sensors and wrenches left out", ("sensors", "wrenches")),
        ("results left out", ("results",)),
    ):
        changed = replace(present, **{name: getattr(scene, name) for name in names})
        if changed != present:
            present = changed
            yield title, present


def _tapes(tree: Tree, request: Request) -> dict[str, Tape]:
    """Write the functions that are straight-line programs."""
    written = [family.value for family in write_families(tree, request)]
    return {function.name: function for function in written if isinstance(function, Tape)}


def _count(tree: Tree, request: Request) -> dict[str, int]:
    return {name: count(tape).paper for name, tape in _tapes(tree, request).items() if not tape.giving(Role.SETUP)}


def _compare(model: Model, request: Request) -> dict[str, float]:
    scene = request.scene
    fixed = replace(scene, parameters=tuple((p.name, Kind.CONSTANT) for p in model.parameters))
    whole = replace(EVERYTHING, parameters=fixed.parameters, gravity=scene.gravity, wrenches=scene.wrenches)
    comparison = _Comparison.begin(model, whole, fixed, request.reductions)
    reduced = _tapes(comparison.reduced, replace(request, runtime=False, scene=fixed))
    deviations: dict[str, float] = {}
    for name, tape in reduced.items():
        if name in FUNCTIONS and not tape.giving(Role.CONDITION):
            deviations[name] = max(comparison.deviate(tape, seed) for seed in range(POINTS))
    return deviations


@dataclass(frozen=True)
class _Comparison:
    """The whole model and the model reduced by a scene, with constant parameters."""

    whole: Tree
    reduced: Tree
    at: Array  # the coordinates of locked joints; others are 0
    moving: list[int]  # indices, from 0, of the whole model's joints that remain
    free: list[int]  # indices of their coordinates: the same, except with quaternions
    reductions: Reductions
    scene: Scene

    @staticmethod
    def begin(model: Model, whole_scene: Scene, scene: Scene, reductions: Reductions) -> _Comparison:
        whole, reduced = _build(model, whole_scene), _build(model, scene)
        valuation = Valuation(model.parameters, ())
        locked = {name: valuation.number(("locked", name), value) for name, value in scene.locked}
        at = np.array([locked.get(name, 0.0) for name in whole.coordinates])
        moving, free = (
            [k for k, name in enumerate(names) if name not in locked]
            for names in ([joint.name for joint in whole.joints], whole.coordinates)
        )
        return _Comparison(whole, reduced, at, moving, free, reductions, scene)

    def deviate(self, tape: Tape, seed: int) -> float:
        """Compare one reduced function at a random state."""
        state = self._draw(seed)
        found = _evaluate(tape, self._reduce(state))
        accelerations = tape.giving(Role.ACCELERATION)
        if accelerations:
            qdd = np.zeros(len(self.whole.joints))
            qdd[self.moving] = found[accelerations.name][:, 0]
            residual = straight(FUNCTIONS[REFERENCE].build(self.whole, self.reductions))
            rows, still = (
                _evaluate(residual, state | {accelerations.name: x})[ports.RESIDUAL.name][self.moving]
                for x in (qdd, 0 * qdd)
            )
            return float(np.abs(rows).max() / np.abs(still).max())
        expected = _evaluate(straight(FUNCTIONS[tape.name].build(self.whole, self.reductions)), state)
        compared = [o for o in tape.outputs if not (self._is_grounded and o.port in _OF_ALL_MASS)]
        return max(
            (_differ(found[o.name], self._pick(o.port, expected[o.name])) for o in compared),
            default=0.0,
        )

    @property
    def _is_grounded(self) -> bool:
        """Return whether a body is locked to the base, which has no mass."""
        left = {body.joint.name for body in self.reduced.bodies}
        return any(body.parent == 0 and body.joint.name not in left for body in self.whole.bodies)

    def _draw(self, seed: int) -> State:
        source = random.Random(seed)
        n, m = len(self.whole.joints), sum(joint.actuated for joint in self.whole.joints)
        sizes = {"q": len(self.at), "qd": n, "qdd": n, "u": m, "w": self.whole.open_entries}
        state = {name: np.array([source.uniform(-1.0, 1.0) for _ in range(size)]) for name, size in sizes.items()}
        held = [k for k in range(len(self.at)) if k not in self.free]
        still = [k for k in range(n) if k not in self.moving]
        state["q"][held] = self.at[held]
        state["qd"][still] = state["qdd"][still] = 0.0
        if not self.scene.motion:
            state["qd"][:] = 0.0
        return state

    def _reduce(self, state: State) -> State:
        """Return the state of the reduced model that belongs to a state of the whole model."""
        driven = [k for k, joint in enumerate(self.whole.joints) if joint.actuated]
        kept = [x.name for x in self.reduced.wrenches]
        left = [x.name in kept for x in self.whole.wrenches for v in (x.force, x.moment) if v is None for _ in "xyz"]
        left += [name in self.reduced.signals for name in self.whole.signals]
        return {
            "q": state["q"][self.free],
            **{name: state[name][self.moving] for name in ("qd", "qdd")},
            "u": state["u"][[k in self.moving for k in driven]],
            "w": state["w"][np.array(left, dtype=bool)],
        }

    def _pick(self, port: Port, values: Array) -> Array:
        """Return the rows and columns of a result of the whole model that the reduced model has."""
        rows, cols = (self._select(axis, n) for axis, n in zip((port.rows, port.cols), values.shape, strict=True))
        return values[np.ix_(rows, cols)]

    def _select(self, axis: Axis | None, size: int) -> list[int]:
        """Return the entries along an axis of the given size that the reduced model keeps."""
        if axis is None:
            return list(range(size))
        left, count = self._left[axis]
        width = size // count if count else 0
        return [width * k + r for k in left for r in range(width)]

    @cached_property
    def _left(self) -> Mapping[Axis, tuple[list[int], int]]:
        """The joints, coordinates, sensors and frames that are left, and their number in the whole model."""
        kept, names = {s.name for s in self.reduced.sensors}, [x.name for x in self.whole.sensors]
        frames, touching = _frames(self.whole), {x.name for x in self.reduced.distances}
        bodies = [x.name for x in self.whole.bodies]
        return {
            Axis.VELOCITIES: (self.moving, len(self.whole.joints)),
            Axis.COORDINATES: (self.free, len(self.at)),
            Axis.SENSORS: ([k for k, name in enumerate(names) if name in kept], len(names)),
            Axis.CONTACTS: (
                [k for k, x in enumerate(self.whole.distances) if x.name in touching],
                len(self.whole.distances),
            ),
            Axis.ELEMENTS: (
                [k for k, name in enumerate(self.whole.elements) if name in self.reduced.elements],
                len(self.whole.elements),
            ),
            Axis.MOMENTS: ([bodies.index(x.name) for x in self.reduced.bodies], len(bodies)),
            Axis.BODIES: ([bodies.index(x.name) for x in self.reduced.bodies], len(bodies)),
            Axis.FRAMES: ([frames.index(frame) for frame in _frames(self.reduced)], len(frames)),
        }


def _frames(tree: Tree) -> list[tuple[str, str]]:
    return [("body", b.name) for b in tree.bodies] + [("sensor", s.name) for s in tree.sensors]


def _evaluate(tape: Tape, state: State) -> State:
    """Evaluate a tape to full matrices."""
    values = evaluate(tape, {i.name: list(state[i.name]) for i in tape.inputs}, FLOATS)
    results = {}
    for output in tape.outputs:
        results[output.name] = np.zeros((output.sparsity.rows, output.sparsity.cols))
        for place, value in zip(output.sparsity.entries, values[output.name], strict=True):
            results[output.name][place] = value
    return results


def _differ(found: Array, expected: Array) -> float:
    size = max(float(np.abs(expected).max(initial=0.0)), float(np.abs(found).max(initial=0.0)))
    return float(np.abs(found - expected).max(initial=0.0)) / size if size else 0.0
