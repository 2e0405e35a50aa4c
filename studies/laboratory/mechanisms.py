"""Mechanisms on which methods fail, as model files, and random states.

Two kinds of chains of thin rods of 1 kg and 1 m along x: `straight` ones in a plane, with axes all along z, and
`spatial` ones, with axes along z, y, x in turn.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
States = Mapping[str, Array]  # (K, size) by name
State = Mapping[str, Array]  # (size,) by name

# Three motions that do not meet: a point mass of 1 kg on a massless rod of 1 m (IFToMM's A01), which a force can push;
# a spring and a damper with 0.3 kg; and a mass whose own force drives it away, x'' = b x^3.
SLIDER_AND_BOB = """
name: bench
gravity: [0, -9.81, 0]
parameters:
  k: {value: 40, kind: runtime}
  c: {value: 0, kind: runtime}
  b: {value: 0, kind: runtime}
bodies:
  - name: bob
    joint: {type: revolute, axis: z, actuated: false}
    mass: 1
    com: [0, -1, 0]
  - name: slider
    joint: {type: prismatic, axis: x, stiffness: k, damping: c, limits: [-1, 1]}
    mass: 0.3
  - name: runner
    joint: {type: prismatic, axis: x, actuated: false, force: b*q**3}
    mass: 1
frames:
  - {name: tip, body: bob, position: [0, -1, 0]}
wrenches:
  - {name: push, body: bob, position: [0, -1, 0], frame: base, force: input}
"""

# A cart of 1 kg and a pole with 0.3 kg at 0.5 m, hanging at 0 (M. Kelly, SIAM Review 59 (2017), section 6).
CART_POLE = """
name: cart_pole
gravity: [0, 0, -9.81]
bodies:
  - name: cart
    joint: {type: prismatic, axis: x}
    mass: 1
  - name: pole
    parent: cart
    joint: {type: revolute, axis: -y, actuated: false}
    mass: 0.3
    com: [0, 0, -0.5]
"""

SLIDE = """
name: slide
gravity: [0, 0, 0]
bodies:
  - name: slide
    joint: {type: prismatic, axis: x}
    mass: 1
"""

# x'' = rate^2 sin x + u: small motions grow by exp(rate t).
UNSTABLE = """
name: unstable
gravity: [0, 0, 0]
bodies:
  - name: x
    joint: {{type: prismatic, axis: x, force: {rate}**2*sin(q)}}
    mass: 1
"""

# IFToMM's A01 in Cartesian coordinates: 1 kg, held at 1 m from the origin by a rod without mass; at first level.
PENDULUM_ROD = """
name: pendulum_rod
gravity: [0, -9.81, 0]
bodies:
  - name: rail
    joint: {name: x, type: prismatic, axis: x, actuated: false}
  - name: bob
    parent: rail
    joint: {name: y, type: prismatic, axis: y, actuated: false}
    mass: 1
loops:
  - {name: rod, type: rod, length: 1, from: {body: base}, to: {body: bob}}
assembly: {x: 1, y: 0}
"""

# IFToMM's A04: five rods along edges of a cube, and six hinges. Each entry: a hinge's axis, its place on the rod
# before, and the rod's direction.
BRICARD = (
    ("y", (0, 0, 0), (1, 0, 0)),
    ("z", (1, 0, 0), (0, -1, 0)),
    ("x", (0, -1, 0), (0, 0, 1)),
    ("y", (0, 0, 1), (-1, 0, 0)),
    ("z", (-1, 0, 0), (0, 1, 0)),
)

LOCKS = {"Cardan": "zyx", "wrist": "zyz"}  # axes of three joints through one point


def write(folder: Path, text: str) -> Path:
    """Write a model file, named by its content."""
    path = folder / f"{hashlib.sha256(text.encode()).hexdigest()[:16]}.yaml"
    folder.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def describe_chain(axes: Sequence[str], factors: Sequence[float] = ()) -> str:
    """Hang thin rods on each other, mass and inertia times a factor each."""
    lines = ["name: rods", "gravity: [0, -9.81, 0]", "bodies:"]
    for k, axis in enumerate(axes, 1):
        factor = factors[k - 1] if factors else 1
        lines += [
            f"  - name: b{k}",
            *([f"    parent: b{k - 1}"] if k > 1 else []),
            f"    joint: {{name: q{k}, type: revolute, axis: {axis}{', position: [1, 0, 0]' if k > 1 else ''}}}",
            f"    mass: {factor!r}",
            "    com: [0.5, 0, 0]",
            f"    inertia: [{factor!r}/1200, {factor!r}/12, {factor!r}/12]",
        ]
    return "\n".join(lines) + "\n"


def describe_straight(size: int) -> str:
    """Describe a chain in a plane."""
    return describe_chain("z" * size)


def describe_spatial(size: int, factors: Sequence[float] = ()) -> str:
    """Describe a chain with axes along z, y, x in turn."""
    return describe_chain([("z", "y", "x")[k % 3] for k in range(size)], factors)


def describe_lock(axes: str) -> str:
    """Turn one body about three axes through a point; what is between the joints has no mass."""
    links = [
        f"  - name: b{k}\n{f'    parent: b{k - 1}' + chr(10) if k > 1 else ''}"
        f"    joint: {{name: q{k}, type: revolute, axis: {axis}}}\n"
        for k, axis in enumerate(axes, 1)
    ]
    body = "    mass: 1\n    com: [0.1, 0.2, 0.3]\n    inertia: [1, 2, 3]\n"
    return "name: axes\ngravity: [0, -9.81, 0]\nbodies:\n" + "".join(links) + body


def describe_elbow() -> str:
    """Hold a point mass by two links without mass, with parallel axes; it locks where it is stretched."""
    return """
name: elbow
gravity: [0, -9.81, 0]
bodies:
  - name: b1
    joint: {name: q1, type: revolute, axis: z}
  - name: b2
    parent: b1
    joint: {name: q2, type: revolute, axis: z, position: [0.7, 0, 0]}
    mass: 1
    com: [0.4, 0, 0]
"""


def describe_bricard() -> str:
    """Describe Bricard's mechanism: rods of 1 m, 1 kg and a square section of 0.1 m."""
    lines = ["name: bricard", "gravity: [0, -9.81, 0]", "bodies:"]
    for k, (axis, place, direction) in enumerate(BRICARD, 1):
        com = [x / 2 for x in direction]
        inertia = ", ".join("0.01/6" if x else "1.01/12" for x in direction)
        lines += [
            f"  - name: rod{k}",
            *([f"    parent: rod{k - 1}"] if k > 1 else []),
            f"    joint: {{name: q{k}, type: revolute, axis: {axis}, actuated: false, position: {list(place)}}}",
            "    mass: 1",
            f"    com: {com}",
            f"    inertia: [{inertia}]",
        ]
    ends = "from: {body: rod5, position: [0, 1, 0]}, to: {body: base, position: [0, 0, 1]}"
    return "\n".join(lines) + f"\nloops:\n  - {{name: last, type: hinge, axis: x, {ends}}}\n"


def describe_four_bars(bars: int) -> str:
    """Describe IFToMM's A02: upright rods a0, a1, ... on the base, level ones between their ends, of 1 m and 1 kg."""
    lines, loops = ["name: four_bars", "gravity: [0, -9.81, 0]", "bodies:"], ["loops:"]
    for k in range(bars + 1):
        joint = f"{{name: a{k}, type: revolute, axis: z, actuated: false, position: [{k}, 0, 0]}}"
        lines += [f"  - name: upright{k}", f"    joint: {joint}"]
        lines += ["    mass: 1", "    com: [0, 0.5, 0]", "    inertia: [1/12, 0, 1/12]"]
        if k == bars:
            break
        joint = f"{{name: b{k + 1}, type: revolute, axis: z, actuated: false, position: [0, 1, 0]}}"
        lines += [f"  - name: level{k + 1}", f"    parent: upright{k}", f"    joint: {joint}"]
        lines += ["    mass: 1", "    com: [0.5, 0, 0]", "    inertia: [0, 1/12, 1/12]"]
        ends = f"from: {{body: level{k + 1}, position: [1, 0, 0]}}, to: {{body: upright{k + 1}, position: [0, 1, 0]}}"
        loops.append(f"  - {{name: B{k + 1}, type: hinge, {ends}}}")
    return "\n".join((*lines, *loops, "independent: [a0]")) + "\n"


def draw(size: int, seeds: Sequence[int], *, q: float | None = None) -> dict[str, Array]:
    """Draw states: angles in (-pi, pi), unless all are `q`; rates, accelerations and forces in (-1, 1)."""
    rows: dict[str, list[Array]] = {name: [] for name in ("q", "qd", "qdd", "u")}
    for seed in seeds:
        rng = np.random.default_rng(seed)
        angles = rng.uniform(-np.pi, np.pi, size)
        rows["q"].append(angles if q is None else np.full(size, q))
        for name in ("qd", "qdd", "u"):
            rows[name].append(rng.uniform(-1, 1, size))
    return {name: np.array(values) for name, values in rows.items()}


def round_to_single(states: States) -> dict[str, Array]:
    """Round states to numbers that single precision has."""
    return {name: values.astype(np.float32).astype(np.float64) for name, values in states.items()}
