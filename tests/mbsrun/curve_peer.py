"""OpenSim's numbers of muscles of a file: a script, since OpenSim stands in another environment.

It reads JSON from stdin: `file`, whose one coordinate moves all muscles, and `states`: `q`, `qd`, and `activations` and
`fibres` (lengths, of elastic tendons alone) by muscle, and `excitations` if activations are not meant. It prints JSON:
for each state and muscle `tension`, `fibre`, `cosine`, `speed`, the rate of fibres along the tendon, and `plain` and
`dependent`, metabolic rates by Bhargava's model without and with heat that depends on the isometric force, smoothed.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import opensim as osim

KINDS = {"plain": False, "dependent": True}


def read(model: Any, name: str) -> Any:
    """Find the metabolics of a muscle."""
    return osim.Bhargava2004SmoothedMuscleMetabolics.safeDownCast(model.getComponent(f"/{name}"))


def add_metabolics(model: Any) -> None:
    """Add the metabolics of all kinds to each muscle, without the rate of a body at rest."""
    for k in range(model.getMuscles().getSize()):
        muscle = model.getMuscles().get(k)
        for kind, is_dependent in KINDS.items():
            part = osim.Bhargava2004SmoothedMuscleMetabolics()
            part.setName(f"{kind}_{muscle.getName()}")
            part.set_basal_coefficient(0)
            part.set_use_smoothing(True)
            part.set_use_force_dependent_shortening_prop_constant(is_dependent)
            part.addMuscle(muscle.getName(), muscle)
            model.addComponent(part)
    model.finalizeConnections()


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
        controls[k] = given.get("excitations", given["activations"])[muscle.getName()]
    model.setControls(state, controls)
    model.realizeDynamics(state)
    return {
        muscle.getName(): {
            "tension": muscle.getActuation(state),
            "fibre": muscle.getFiberLength(state),
            "cosine": muscle.getCosPennationAngle(state),
            "speed": muscle.getFiberVelocityAlongTendon(state),
            **{kind: read(model, f"{kind}_{muscle.getName()}").getTotalMetabolicRate(state) for kind in KINDS},
        }
        for muscle in muscles
    }


if __name__ == "__main__":
    osim.Logger.setLevelString("Off")
    wanted = json.load(sys.stdin)
    found = osim.Model(wanted["file"])
    add_metabolics(found)
    start = found.initSystem()
    print("\n" + json.dumps([compute(found, start, given) for given in wanted["states"]]))
