"""OpenSim's numbers of muscles of a file: a script, since OpenSim stands in another environment.

It reads JSON from stdin: `file`, whose one coordinate moves all muscles, and `states`: `q`, `qd`, and `activations` and
`fibres` (lengths, of elastic tendons alone) by muscle. It prints JSON: for each state and muscle `tension`, `fibre`,
`cosine` and `speed`, the rate of fibres along the tendon.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import opensim as osim


def compute(model: Any, state: Any, given: dict[str, Any]) -> dict[str, dict[str, float]]:
    """Compute the muscles at a state."""
    coordinate = model.getCoordinateSet().get(0)
    coordinate.setValue(state, given["q"], False)
    coordinate.setSpeedValue(state, given["qd"])
    muscles = [model.getMuscles().get(k) for k in range(model.getMuscles().getSize())]
    for name, length in given["fibres"].items():
        model.setStateVariableValue(state, f"/forceset/{name}/fiber_length", length)
    for muscle in muscles:
        if not muscle.get_ignore_activation_dynamics():
            activation = given["activations"][muscle.getName()]
            model.setStateVariableValue(state, f"/forceset/{muscle.getName()}/activation", activation)
    model.realizeVelocity(state)
    controls = osim.Vector(len(muscles), 0.0)
    for k, muscle in enumerate(muscles):
        controls[k] = given["activations"][muscle.getName()]
    model.setControls(state, controls)
    model.realizeDynamics(state)
    return {
        muscle.getName(): {
            "tension": muscle.getActuation(state),
            "fibre": muscle.getFiberLength(state),
            "cosine": muscle.getCosPennationAngle(state),
            "speed": muscle.getFiberVelocityAlongTendon(state),
        }
        for muscle in muscles
    }


if __name__ == "__main__":
    osim.Logger.setLevelString("Off")
    wanted = json.load(sys.stdin)
    found = osim.Model(wanted["file"])
    start = found.initSystem()
    print("\n" + json.dumps([compute(found, start, given) for given in wanted["states"]]))
