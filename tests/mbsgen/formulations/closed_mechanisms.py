"""Mechanisms with closed loops, for tests: planar, spatial, coupled, with a quaternion, driven; and their states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from mbsgen.assembly import assemble
from mbsgen.assembly.mechanism import Mechanism
from mbsgen.assembly.poses import close
from mbsgen.formulations.catalogue import FUNCTIONS
from mbsgen.formulations.reductions import ALL
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.reader import read_model
from mbsgen.model.tree import Kind, Tree
from mbsgen.procedure.procedure import Computation, evaluate

Array = NDArray[np.float64]
ONE = replace(ALL, trials=1)  # plan; plans do not change what is computed
Values = Mapping[str, Sequence[float]]

_FOUR_BAR = """
name: four_bar
gravity: [0, -9.81, 0]
bodies:
  - {name: crank, joint: {name: q1, type: revolute, axis: z}, mass: 1.0, com: [0.1, 0.02, 0], inertia: [0.01,
     0.01, 0.01]}
  - {name: coupler, parent: crank, joint: {name: q2, type: revolute, axis: z, position: [0.2, 0, 0],
     actuated: false, damping: 0.3},
     mass: 2.0, com: [0.25, 0, 0], inertia: [0.05, 0.05, 0.05]}
  - {name: rocker, joint: {name: q3, type: revolute, axis: z, position: [0.6, 0, 0], actuated: false},
     mass: 1.5, com: [0.2, 0, 0],
     inertia: [0.03, 0.03, 0.03]}
loops:
  - {name: knee, type: hinge, from: {body: coupler, position: [0.5, 0, 0]}, to: {body: rocker, position: [0.4,
     0, 0]}, axis: z}
assembly: {q1: 1.0, q2: -0.5, q3: 1.5}
"""

_SLIDER_CRANK = """
name: slider_crank
gravity: [0, -9.81, 0]
parameters:
  l: {value: 0.35, kind: differentiated}
bodies:
  - {name: crank, joint: {name: q1, type: revolute, axis: z}, mass: 1.0, com: [0.05, 0, 0], inertia: [0.01,
     0.01, 0.01]}
  - {name: rod, parent: crank, joint: {name: q2, type: revolute, axis: z, position: [0.1, 0, 0],
     actuated: false}, mass: 0.5,
     com: [0.15, 0, 0], inertia: [0.005, 0.005, 0.005]}
  - {name: piston, joint: {name: x, type: prismatic, axis: x, position: [0, 0.02, 0], actuated: false,
     damping: 2}, mass: 0.7}
loops:
  - {name: pin, type: ball, from: {body: rod, position: [l, 0, 0]}, to: {body: piston}}
wrenches:
  - {name: gas, body: piston, frame: base, force: input}
assembly: {q1: 0.7, q2: -0.9, x: 0.4}
"""

_FIVE_BAR = """
name: five_bar
gravity: [0, -9.81, 0]
bodies:
  - {name: left, joint: {name: q1, type: revolute, axis: z}, mass: 1.0, com: [0.1, 0, 0], inertia: [0.01, 0.01,
     0.01]}
  - {name: arm, parent: left, joint: {name: q2, type: revolute, axis: z, position: [0.3, 0, 0],
     actuated: false}, mass: 0.8,
     com: [0.2, 0.01, 0], inertia: [0.02, 0.02, 0.02]}
  - {name: right, joint: {name: q3, type: revolute, axis: z, position: [0.25, 0, 0]}, mass: 1.0, com: [0.1, 0, 0],
     inertia: [0.01, 0.01, 0.01]}
  - {name: other, parent: right, joint: {name: q4, type: revolute, axis: z, position: [0.3, 0, 0],
     actuated: false}, mass: 0.8,
     com: [0.2, 0, 0], inertia: [0.02, 0.02, 0.02]}
loops:
  - {name: tip, type: hinge, from: {body: arm, position: [0.4, 0, 0]}, to: {body: other, position: [0.4, 0,
     0]}, axis: z}
assembly: {q1: 2.2, q2: -1.2, q3: 0.9, q4: 1.2}
"""

# A spatial four-bar, RSSR with the coupler as a rod, beside one whose coupler is a body on a universal joint.
_ROD = """
name: spatial_rod
gravity: [0, 0, -9.81]
bodies:
  - {name: crank, joint: {name: q1, type: revolute, axis: z}, mass: 1.0, com: [0.1, 0, 0.05], inertia: [0.01,
     0.02, 0.02]}
  - {name: lever, joint: {name: q2, type: revolute, axis: x, position: [0.5, 0.1, 0], actuated: false}, mass: 1.5,
     com: [0, 0.2, 0], inertia: [0.03, 0.01, 0.03]}
loops:
  - {name: link, type: rod, from: {body: crank, position: [0.2, 0, 0.1]}, to: {body: lever, position: [0, 0.3,
     0]}, length: 0.55}
assembly: {q1: 0.4, q2: 0.5}
"""

_SPATIAL = """
name: spatial
gravity: [0, 0, -9.81]
bodies:
  - {name: crank, joint: {name: q1, type: revolute, axis: z}, mass: 1.0, com: [0.1, 0, 0.05], inertia: [0.01,
     0.02, 0.02]}
  - {name: coupler, parent: crank, joint: {type: universal, axis: y, axis2: z, position: [0.2, 0, 0.1],
     actuated: false},
     mass: 0.6, com: [0.2, 0, 0], inertia: [0.002, 0.01, 0.01]}
  - {name: lever, joint: {name: q2, type: revolute, axis: x, position: [0.5, 0.1, 0], actuated: false}, mass: 1.5,
     com: [0, 0.2, 0], inertia: [0.03, 0.01, 0.03]}
loops:
  - {name: link, type: ball, from: {body: coupler, position: [0.55, 0, 0]}, to: {body: lever, position: [0,
     0.3, 0]}}
assembly: {q1: 0.4, q2: 0.5}
"""

_COUPLED = """
name: geared
gravity: [0, -9.81, 0]
parameters:
  L: {value: 0.5, kind: runtime}
bodies:
  - {name: crank, joint: {name: q1, type: revolute, axis: z}, mass: 1.0, com: [0.1, 0, 0], inertia: [0.01,
     0.01, 0.01]}
  - {name: wheel, joint: {name: w, type: revolute, axis: z, position: [-0.3, 0, 0], follows: {joint: q3,
     ratio: -2.5}}, mass: 0.4,
     inertia: [0.01, 0.01, 0.01]}
  - {name: coupler, parent: crank, joint: {name: q2, type: revolute, axis: z, position: [0.2, 0, 0],
     actuated: false}, mass: 2.0,
     com: [0.25, 0, 0], inertia: [0.05, 0.05, 0.05]}
  - {name: rocker, joint: {name: q3, type: revolute, axis: z, position: [0.6, 0, 0], actuated: false},
     mass: 1.5, com: [0.2, 0, 0],
     inertia: [0.03, 0.03, 0.03]}
  - {name: cam, parent: rocker, joint: {name: s, type: prismatic, axis: x, position: [0.4, 0, 0],
     actuated: false}, mass: 0.2}
loops:
  - {name: knee, type: hinge, from: {body: coupler, position: [L, 0, 0]}, to: {body: rocker, position: [0.4, 0,
     0]}, axis: z}
constraints:
  - {name: profile, equation: s - 0.05*sin(2*q1) - 0.01*q3**2}
assembly: {q1: 1.0, q2: -0.5, q3: 1.5}
"""

_PLATFORM = """
name: platform
gravity: [0, 0, -9.81]
bodies:
  - {name: plate, joint: {type: floating}, mass: 2.0, inertia: [0.03, 0.04, 0.06]}
  - {name: arm, joint: {name: q1, type: revolute, axis: y, position: [0.4, 0, 0]}, mass: 1.0, com: [0.05, 0, 0.1],
     inertia: [0.01, 0.01, 0.002]}
loops:
  - {name: foot, type: ball, from: {body: plate, position: [0.3, 0, 0]}, to: {body: arm, position: [0, 0, 0.25]}}
  - {name: strut, type: rod, from: {body: plate, position: [-0.2, 0.2, 0]}, to: {body: base, position: [-0.3,
     0.2, -0.3]}, length: 0.6}
assembly: {plate.z: 0.25}
"""

_MOTOR = "{name: q3, type: revolute, axis: z, "
_DRIVEN = _FIVE_BAR.replace("five_bar", "driven").replace(_MOTOR, f"{_MOTOR}actuated: false, ") + "driven: [q3]\n"

_FOLLOWS = "follows: {joint: q3,\n     ratio: -2.5}"
_CAM = "  - {name: profile"
_SUMMED = (
    _COUPLED.replace("geared", "summed")
    .replace(_FOLLOWS, "actuated: false")
    .replace(_CAM, "  - {name: sum, equation: w - q1 + 2.5*q3 - 0.1}\n" + _CAM)
)

TEXTS = {
    "four_bar": _FOUR_BAR,
    "slider_crank": _SLIDER_CRANK,
    "five_bar": _FIVE_BAR,
    "spatial_rod": _ROD,
    "spatial": _SPATIAL,
    "geared": _COUPLED,
    "summed": _SUMMED,
    "platform": _PLATFORM,
    "driven": _DRIVEN,
}


def read(text: str) -> Tree:
    """Read and assemble a model."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "model.yaml"
        path.write_text(text)
        return assemble(build_tree(read_model(path)))


@cache
def make(name: str) -> Tree:
    """Return one of TEXTS, assembled."""
    return read(TEXTS[name])


@cache
def build(name: str, tree: Tree) -> Computation:
    return FUNCTIONS[name].build(tree, ONE)


def run(name: str, tree: Tree, given: Values) -> dict[str, Array]:
    tape = build(name, tree)
    found = evaluate(tape, {i.name: given[i.name] for i in tape.inputs})
    return {key: np.array(values, float) for key, values in found.items()}


def spread(name: str, tree: Tree, given: Values, result: str) -> Array:
    """Return a matrix with its zeros."""
    output, values = build(name, tree).output(result), run(name, tree, given)[result]
    full = np.zeros((output.sparsity.rows, output.sparsity.cols))
    for place, value in zip(output.sparsity.entries, values, strict=True):
        full[place] = value
    return full


def draw(tree: Tree, seed: int) -> dict[str, Array]:
    """Draw a closed state near the assembled pose, with forces and independent accelerations."""
    rng, closure = np.random.default_rng(seed), tree.closure
    n, f = len(tree.joints), len(closure.independent)
    pose = np.array(closure.pose)
    state = {
        "q": close(Mechanism(tree), pose + 0.1 * rng.uniform(-1, 1, pose.size)).q,
        "qd": np.zeros(n),
        "yd": rng.uniform(-2, 2, f),
        "ydd": rng.uniform(-3, 3, f),
        "u": rng.uniform(-3, 3, sum(body.joint.actuated for body in tree.bodies)),
        "a": rng.uniform(-3, 3, len(tree.driven)),
        "tau": rng.uniform(-3, 3, len(tree.driven)),
        "w": rng.uniform(-5, 5, 3 * len(tree.wrenches)),
        "theta": np.array([x.value for x in tree.parameters if x.kind is Kind.DIFFERENTIATED]),
        "p": np.array([x.value for x in tree.parameters if x.kind is Kind.RUNTIME]),
    }
    own, other = list(closure.independent), list(closure.dependent)
    J = spread("loop_jacobian", tree, state, "J")
    Z = np.zeros((n, f))
    Z[own] = np.eye(f)
    Z[other] = -np.linalg.solve(J[:, other], J[:, own])
    state |= {"J": J, "Z": Z, "qd": Z @ state["yd"]}
    state["qdd"] = Z @ state["ydd"]
    state["qdd"][other] -= np.linalg.solve(J[:, other], run("loop_jacobian", tree, state)["gamma"])
    return state
