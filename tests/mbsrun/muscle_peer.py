"""OpenSim's numbers of the muscles of models/muscles/leg.yaml: a script, since OpenSim stands in another environment.

It reads JSON from stdin, a list of states: `q`, `qd`, `activations`, `forces` and `rates` of tendons. It prints
JSON: for each state and muscle the length, its rate, the tension, the fibres' length, the cosine of their angle, moment
arms, and the residual of an elastic tendon.
"""

from __future__ import annotations

import json
import math
import sys
from typing import Any

import opensim as osim

DEGREE = math.pi / 180
MUSCLES: dict[str, Any] = {
    "rectus": {
        "numbers": {"max_isometric_force": 1169, "optimal_fiber_length": 0.114, "tendon_slack_length": 0.37},
        "more": {"pennation_angle_at_optimal": 5 * DEGREE, "fiber_damping": 0.01, "ignore_tendon_compliance": True},
        "path": [
            ("base", (0.05, 0.02, 0.01)),
            ("thigh", (0.06, -0.3, 0.01)),
            ("thigh", (0.06, -0.38, 0.01)),
            ("shank", (0.04, -0.05, 0)),
        ],
    },
    "vastus": {
        "numbers": {"max_isometric_force": 5000, "optimal_fiber_length": 0.107, "tendon_slack_length": 0.2},
        "more": {"active_force_width_scale": 1.2},
        "path": [("thigh", (0.03, -0.15, 0.02)), ("thigh", (0.05, -0.38, 0.01)), ("shank", (0.04, -0.05, 0.01))],
    },
    "sartorius": {
        "numbers": {"max_isometric_force": 156, "optimal_fiber_length": 0.403, "tendon_slack_length": 0.11},
        "more": {
            "pennation_angle_at_optimal": 10 * DEGREE,
            "ignore_passive_fiber_force": True,
            "tendon_strain_at_one_norm_force": 0.06,
        },
        "path": [("base", (0.02, 0.03, 0.05)), ("shank", (0.03, -0.1, 0))],
    },
}


def make_leg() -> Any:
    """Make the leg, with muscles whose activations are their controls."""
    model, zero = osim.Model(), osim.Vec3(0)
    model.set_gravity(osim.Vec3(0, -9.81, 0))
    bodies = {"base": model.getGround()}
    parent, at = model.getGround(), zero
    for body, joint, mass, moments in (
        ("thigh", "hip", 8.0, (0.1, 0.02, 0.1)),
        ("shank", "knee", 4.0, (0.05, 0.01, 0.05)),
    ):
        bodies[body] = osim.Body(body, mass, osim.Vec3(0, -0.2, 0), osim.Inertia(*moments))
        model.addBody(bodies[body])
        pin = osim.PinJoint(joint, parent, at, zero, bodies[body], zero, zero)
        pin.updCoordinate().setName(joint)
        model.addJoint(pin)
        parent, at = bodies[body], osim.Vec3(0, -0.4, 0)
    for name, given in MUSCLES.items():
        muscle = osim.DeGrooteFregly2016Muscle()
        muscle.setName(name)
        for key, value in (given["numbers"] | given["more"]).items():
            getattr(muscle, f"set_{key}")(value)
        muscle.set_ignore_activation_dynamics(True)
        muscle.set_tendon_compliance_dynamics_mode("implicit")
        for k, (body, place) in enumerate(given["path"]):
            muscle.addNewPathPoint(f"{name}_{k}", bodies[body], osim.Vec3(*place))
        model.addForce(muscle)
    model.finalizeConnections()
    return model


def compute(model: Any, state: Any, given: dict[str, Any]) -> list[dict[str, Any]]:
    """Compute everything at a state."""
    coordinates = [model.getCoordinateSet().get(k) for k in range(2)]
    for coordinate, q, qd in zip(coordinates, given["q"], given["qd"], strict=True):
        coordinate.setValue(state, q, False)
        coordinate.setSpeedValue(state, qd)
    muscles = [osim.DeGrooteFregly2016Muscle.safeDownCast(model.getMuscles().get(k)) for k in range(len(MUSCLES))]
    controls = osim.Vector(len(MUSCLES), 0.0)
    for k, activation in enumerate(given["activations"]):
        controls[k] = activation
    model.realizeVelocity(state)
    model.setControls(state, controls)
    elastic = [muscle for muscle in muscles if not muscle.get_ignore_tendon_compliance()]
    for muscle, force, rate in zip(elastic, given["forces"], given["rates"], strict=True):
        muscle.setNormalizedTendonForce(state, force)
        muscle.setDiscreteVariableValue(state, "implicitderiv_normalized_tendon_force", rate)
    model.realizeDynamics(state)
    return [
        {
            "length": muscle.getLength(state),
            "rate": muscle.getLengtheningSpeed(state),
            "tension": muscle.getActuation(state),
            "fibre": muscle.getFiberLength(state),
            "cosine": muscle.getCosPennationAngle(state),
            "arms": [muscle.computeMomentArm(state, x) for x in coordinates],
            "equilibrium": muscle.getImplicitResidualNormalizedTendonForce(state)
            if not muscle.get_ignore_tendon_compliance()
            else 0.0,
        }
        for muscle in muscles
    ]


if __name__ == "__main__":
    osim.Logger.setLevelString("Off")
    leg = make_leg()
    start = leg.initSystem()
    print("\n" + json.dumps([compute(leg, start, given) for given in json.load(sys.stdin)]))
