"""The kinds of models that commands may meet, each as small as it can be: the rows of the table of commands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from textwrap import dedent

FREEDOMS = "left when nothing moves"
QUATERNIONS: dict[str, str | None] = {
    "--method symplectic-euler": "takes no quaternions",
    "generate --acados": "a joint with a quaternion has more",
    "generate --acados-untimed": "a joint with a quaternion has more",
}
CONSTRAINED: dict[str, str | None] = {
    **{
        f"--method {name}": "takes no loops or driven joints"
        for name in ("symplectic-euler", "lsoda", "radau", "bdf", "gauss", "moreau")
    },
    "generate --acados": "move no driven joints",
    "generate --acados-untimed": "move no driven joints",
    "generate --tolerance": "loops, constraints or driven joints are not estimated",
}
PASSIVE: dict[str, str | None] = dict.fromkeys(("solve", "controller", "track", "sweep", "study"), "nothing to control")


@dataclass(frozen=True)
class Kind:
    """A model file, and what a problem of the model and a motion of it have to say."""

    model: str
    motion: Mapping[str, str] = field(default_factory=dict)  # of the independent coordinates over the time, by name
    problem: str = ""  # lines beside the horizon and the cost
    start: str = "{}"  # the pose
    columns: Mapping[str, float] = field(default_factory=dict)  # a row of a recorded motion
    refused: Mapping[str, str | None] = field(default_factory=dict)
    # words of commands -> words of the error, or None where they are accepted; the first that fits counts


def _gravity(kind: Kind) -> str:
    return "" if "gravity" in kind.model else "gravity: [0, 0, -9.81]\n"


def write_model(name: str) -> str:
    """Return the text of a kind's model file; each has a sensor `tip`, and gravity unless it says otherwise."""
    kind = KINDS[name]
    return f"name: {name}\n{_gravity(kind)}{dedent(kind.model)}"


def write_problem(name: str) -> str:
    """Return the text of a problem of it: two intervals, from a pose at rest to wherever the least effort leads."""
    kind = KINDS[name]
    rest = dedent(kind.problem) or "cost: {inputs: 1}\n"
    return (
        f"model: {name}.yaml\nhorizon: 0.1\nintervals: 2\nscheme: radau\ndegree: 2\naccuracy: 1\n"
        f"start: {{pose: {kind.start}}}\n{rest}"
    )


KINDS: dict[str, Kind] = {
    "joint": Kind(
        """\
        bodies:
          - {name: rod, joint: {name: q1, type: revolute, axis: y}, mass: 1, com: [0, 0, -0.5], inertia: [0.1, 0.1, 0]}
        frames: [{name: tip, body: rod, position: [0, 0, -1]}]
        """,
        {"q1": "0.3*sin(2*t)"},
        columns={"q1": 0.1},
    ),
    "ball": Kind(
        """\
        bodies:
          - {name: bob, joint: {type: ball}, mass: 1, com: [0, 0, -1], inertia: [0.1, 0.1, 0.1]}
        frames: [{name: tip, body: bob, position: [0, 0, -1]}]
        """,
        columns={"bob.qx": 0, "bob.qy": 0, "bob.qz": 0.6, "bob.qw": 0.8},
        refused=QUATERNIONS | {"inverse": FREEDOMS},
    ),
    "free": Kind(
        """\
        bodies:
          - {name: hull, joint: {type: free}, mass: 1, inertia: [0.1, 0.2, 0.3]}
        frames: [{name: tip, body: hull, position: [0.1, 0, 0]}]
        wrenches: [{name: jet, body: hull, force: input}]
        """,
        problem="""\
        cost: {running: [{expression: (fz_jet - 9)**2}]}
        wrenches: {jet: {force: [0, 0, {range: [0, 60], guess: 5}]}}
        """,
        columns={"hull.x": 0, "hull.y": 0, "hull.z": 1, "hull.qx": 0, "hull.qy": 0, "hull.qz": 0, "hull.qw": 1},
        refused=QUATERNIONS
        | {
            "inverse": FREEDOMS,
            "linearise --settle": "no equilibrium was found",
            "linearise": "the pose is no equilibrium",
            "solve --form": "takes no forces and wrenches by expressions",
            "controller": "the model leaves jet open",
            "track": "the problem gives further forces",
        },
    ),
    "planar": Kind(
        """\
        bodies:
          - name: sled
            joint: {type: planar, plane: xy, axes: {x: {actuated: true, damping: 0.1}}}
            mass: 1
            com: [0.1, 0, 0]
            inertia: [0.1, 0, 0.1]
        frames: [{name: tip, body: sled, position: [0.2, 0, 0]}]
        """,
        {"sled.x": "0.1*t", "sled.y": "0", "sled.rz": "0.2*t"},
        columns={"sled.x": 0, "sled.y": 0.1, "sled.rz": 0.2},
        refused={"linearise --regulate": "no input reaches the poles"},
    ),
    "driven": Kind(
        """\
        bodies:
          - {name: table, joint: {name: q1, type: revolute, axis: z, actuated: false}, mass: 2, inertia: [0.2, 0, 0.2]}
          - name: arm
            parent: table
            joint: {name: q2, type: revolute, axis: y, position: [0.3, 0, 0]}
            mass: 1
            com: [0.2, 0, 0]
        driven: [q1]
        frames: [{name: tip, body: arm, position: [0.4, 0, 0]}]
        """,
        {"q2": "0.3*sin(2*t)", "q1": "0.1*t**2"},
        problem="cost: {inputs: 1}\ndriven: {q1: 0.1*t**2}\n",
        columns={"q1": 0, "q2": 0.1},
        refused=CONSTRAINED
        | {
            "solve --form": "takes no driven joints",
            "controller": "driven joints move by the time of the problem",
            "track": "it drives q1, which nothing moves here",
        },
    ),
    "driven_alone": Kind(
        """\
        bodies:
          - {name: table, joint: {name: q1, type: revolute, axis: z, actuated: false}, mass: 2, inertia: [0.2, 0, 0.2]}
        driven: [q1]
        frames: [{name: tip, body: table, position: [0.4, 0, 0]}]
        """,
        {"q1": "0.1*t**2"},
        problem="cost: {running: [{expression: tau_q1**2}]}\ndriven: {q1: 0.1*t**2}\n",
        columns={"q1": 0.1},
        refused=CONSTRAINED | PASSIVE | {"linearise": "driven joints determine the whole motion"},
    ),
    "loop": Kind(
        """\
        bodies:
          - {name: crank, joint: {name: q1, type: revolute, axis: y}, mass: 1, com: [0.1, 0, 0]}
          - name: coupler
            parent: crank
            joint: {name: q2, type: revolute, axis: y, position: [0.2, 0, 0], actuated: false}
            mass: 1
            com: [0.2, 0, 0]
          - name: rocker
            joint: {name: q3, type: revolute, axis: y, position: [0.5, 0, 0], actuated: false}
            mass: 1
            com: [0.15, 0, 0]
        loops:
          - {name: knee, from: {body: coupler, position: [0.4, 0, 0]}, to: {body: rocker, position: [0.3, 0, 0]},
             type: hinge, axis: y}
        independent: [q1]
        assembly: {q1: -1, q3: -1.5}
        frames: [{name: tip, body: coupler, position: [0.4, 0, 0]}]
        """,
        {"q1": "-1 + 0.1*t"},
        start="{q1: -1}",
        columns={"q1": -1.0, "q2": 1.0471975511965976, "q3": -1.5},
        refused=CONSTRAINED | {"generate --zeros": "for the present lengths alone"},
    ),
    "ball_loop": Kind(
        """\
        bodies:
          - {name: bob, joint: {type: ball}, mass: 1, com: [0, 0, -0.5], inertia: [0.1, 0.1, 0.1]}
          - {name: cart, joint: {name: x, type: prismatic, axis: x, position: [0, 0, -1]}, mass: 1}
        loops:
          - {name: pin, type: rod, length: 0.5, from: {body: bob, position: [0, 0, -1]}, to: {body: cart}}
        assembly: {x: 0.5}
        frames: [{name: tip, body: bob, position: [0, 0, -1]}]
        """,
        start="{x: 0.5}",
        columns={"bob.qx": 0, "bob.qy": 0, "bob.qz": 0, "bob.qw": 1, "x": 0.5},
        refused=CONSTRAINED
        | {
            "--method symplectic-euler": "takes no quaternions",
            "inverse": FREEDOMS,
            "solve --form": "the reduced form takes all or none",
        },
    ),
    "driven_loop": Kind(
        """\
        bodies:
          - {name: crank, joint: {name: q1, type: revolute, axis: y, actuated: false}, mass: 1, com: [0.1, 0, 0]}
          - {name: slider, joint: {name: q2, type: prismatic, axis: x, actuated: false}, mass: 1}
        loops: [{name: rod, type: rod, length: 0.5, from: {body: crank, position: [0.2, 0, 0]}, to: {body: slider}}]
        driven: [q1]
        assembly: {q1: -1, q2: 0.6}
        frames: [{name: tip, body: slider}]
        """,
        {"q1": "-1 + 0.1*t**2"},
        problem="cost: {running: [{expression: tau_q1**2}]}\ndriven: {q1: -1 + 0.1*t**2}\n",
        columns={"q1": -1.0, "q2": 0.5784},
        refused=CONSTRAINED | PASSIVE | {"linearise": "driven joints determine the whole motion"},
    ),
    "stuck": Kind(
        """\
        bodies:
          - {name: crank, joint: {name: q1, type: revolute, axis: y}, mass: 1, com: [0.1, 0, 0]}
        constraints: [{name: stop, equation: sin(q1) - 0.5}]
        frames: [{name: tip, body: crank, position: [0.2, 0, 0]}]
        """,
        columns={"q1": 0.5235987755982988},
        refused={"": "no joint free to move"},
    ),
    "constraint": Kind(
        """\
        bodies:
          - {name: wheel, joint: {name: q1, type: revolute, axis: y}, mass: 1, com: [0.1, 0, 0]}
          - {name: valve, joint: {name: q2, type: prismatic, axis: z, actuated: false}, mass: 0.1}
        constraints: [{name: cam, equation: q2 - 0.1*sin(q1)**2}]
        frames: [{name: tip, body: valve}]
        """,
        {"q1": "0.3*sin(2*t)"},
        columns={"q1": 0, "q2": 0},
        refused=CONSTRAINED,
    ),
    "followers": Kind(
        """\
        bodies:
          - {name: left, joint: {name: grip, type: prismatic, axis: y, limits: [0, 0.04]}, mass: 0.1}
          - {name: right, joint: {type: prismatic, axis: -y, follows: {joint: grip, ratio: 1, offset: 0.01}}, mass: 0.1}
          - {name: screw, joint: {type: helical, axis: x, pitch: 0.01}, mass: 0.1, inertia: [0.01, 0.01, 0]}
        frames: [{name: tip, body: right}]
        """,
        {"grip": "0.02 + 0.01*t", "screw": "t"},
        start="{grip: 0.02}",
        columns={"grip": 0.02, "screw": 0},
    ),
    "signals": Kind(
        """\
        bodies:
          - {name: forearm, joint: {name: q1, type: revolute, axis: y}, mass: 1, com: [0, 0, -0.1]}
        signals: [act]
        forces:
          - name: biceps
            from: {body: base, position: [0.05, 0, 0.2]}
            to: {body: forearm, position: [0.04, 0, -0.05]}
            force: 30*act*(1 + sin(t))
        frames: [{name: tip, body: forearm, position: [0, 0, -0.2]}]
        """,
        {"q1": "0.3*sin(2*t)"},
        problem="cost: {running: [{expression: (signal_act - 0.4)**2}]}\nsignals: {act: {range: [0, 1], guess: 0.5}}\n",
        columns={"q1": 0.1},
        refused={
            "linearise": "depend on the time t",
            "inverse-dynamics": 'no column is named "act"',
            "inverse": "read act, which the motion does not give",
            "solve --form": "takes no forces",
            "controller": "forces of the model read act",
            "track": "its forces read act",
        },
    ),
    "contact": Kind(
        """\
        bodies:
          - {name: rail, joint: {name: x, type: prismatic, axis: x}, mass: 0}
          - {name: block, parent: rail, joint: {name: z, type: prismatic, axis: z, actuated: false}, mass: 1}
        contacts:
          - {name: sole, body: block, radius: 0.1, stiffness: 1e3, width: 1e-2, dissipation: 0.5, exponent: 1,
             friction: {coefficient: 0.5, speed: 0.1}}
        frames: [{name: tip, body: block}]
        """,
        {"x": "0.1*t", "z": "0.1"},
        start="{z: 0.09}",
        columns={"x": 0, "z": 0.1},
        refused={"linearise --settle": None, "linearise": "the pose is no equilibrium"},
    ),
    "runtime": Kind(
        """\
        parameters:
          m: {value: 1.5, kind: runtime}
          l: {value: 0.7, kind: runtime}
        bodies:
          - {name: rod, joint: {name: q1, type: revolute, axis: y}, mass: m, com: [0, 0, -l], inertia: [0.1, 0.1, 0]}
        frames: [{name: tip, body: rod, position: [0, 0, -l]}]
        """,
        {"q1": "0.3*sin(2*t)"},
        columns={"q1": 0.1},
    ),
    "weightless": Kind(
        """\
        gravity: [0, 0, 0]
        bodies:
          - {name: rod, joint: {name: q1, type: revolute, axis: z}, mass: 1, com: [0.5, 0, 0]}
          - {name: bar, parent: rod, joint: {name: q2, type: revolute, axis: z, position: [1, 0, 0]}, mass: 1,
             com: [0.5, 0, 0]}
        frames: [{name: tip, body: bar, position: [1, 0, 0]}]
        """,
        {"q1": "t", "q2": "0.5*t"},
        columns={"q1": 0, "q2": 0.1},
    ),
    "passive": Kind(
        """\
        bodies:
          - {name: rod, joint: {name: q1, type: revolute, axis: y, actuated: false}, mass: 1, com: [0, 0, -0.5]}
        """,
        {"q1": "0.3*sin(2*t)"},
        problem="cost: {terminal: [{expression: q_q1**2}]}\n",
        columns={"q1": 0.1},
        refused=PASSIVE | {"linearise --regulate": "no input reaches the poles", "fit-motion": "passive has none"},
    ),
    "rotor": Kind(
        """\
        bodies:
          - name: link
            joint: {name: q1, type: revolute, axis: z, armature: 0.2, friction: {torque: 0.8, speed: 0.01},
                    stiffness: 20, rest: 0.1, damping: 0.5, force: -3*q**3 + 0.1*qd, limits: [-1, null], max_force: 30}
            mass: 0
        """,
        {"q1": "0.3*sin(2*t)"},
        columns={"q1": 0.1},
        refused={"fit-motion": "rotor has none"},
    ),
    "immobile": Kind("bodies: [{name: rock, joint: {type: fixed}, mass: 1}]\n", refused={"": "nothing moves"}),
}
