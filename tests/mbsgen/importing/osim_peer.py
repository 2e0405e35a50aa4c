"""OpenSim's mass matrices, inverse dynamics and places: a script, since OpenSim stands in another environment.

It reads JSON from stdin: `file`, and `states` of coordinates `q`, speeds `u` and accelerations `udot` by name. It
prints JSON: for each state `M` and `tau` in the order of `names`, `bodies` (rotation and position in the ground) and
`markers` (position). Forces act only if they are springs and limits of coordinates.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import opensim as osim

ACTING = ("SpringGeneralizedForce", "CoordinateLimitForce")


class Peer:
    """A model in OpenSim."""

    def __init__(self, file: str) -> None:
        osim.Logger.setLevelString("off")
        self.model = osim.Model(file)
        forces = self.model.updForceSet()
        for k in range(forces.getSize()):
            force = forces.get(k)
            force.set_appliesForce(force.getConcreteClassName() in ACTING)
        self.state = self.model.initSystem()
        found = self.model.getCoordinateSet()
        self.coordinates = {found.get(k).getName(): found.get(k) for k in range(found.getSize())}
        for coordinate in self.coordinates.values():
            coordinate.setLocked(self.state, False)
            coordinate.setClamped(self.state, False)
        self.places = [self._find_place(coordinate) for coordinate in self.coordinates.values()]

    def _find_place(self, coordinate: Any) -> int:
        """Return the number of the speed of a coordinate."""
        state = osim.State(self.state)
        for k in range(state.getNU()):
            state.updU()[k] = 0.0
        coordinate.setSpeedValue(state, 1.0)
        (place,) = [k for k in range(state.getNU()) if state.getU()[k] != 0]
        return int(place)

    def compute(self, given: dict[str, dict[str, float]]) -> dict[str, Any]:
        """Compute everything at a state."""
        model, state = self.model, self.state
        for name, value in given["q"].items():
            self.coordinates[name].setValue(state, value, False)
        udot = osim.Vector(state.getNU(), 0.0)
        for name, place in zip(self.coordinates, self.places, strict=True):
            state.updU()[place] = given["u"].get(name, 0.0)
            udot[place] = given["udot"].get(name, 0.0)
        model.realizeAcceleration(state)
        M = osim.Matrix()
        model.getMatterSubsystem().calcM(state, M)
        tau = osim.InverseDynamicsSolver(model).solve(state, udot)
        return {
            "M": [[M.get(i, j) for j in self.places] for i in self.places],
            "tau": [tau.get(i) for i in self.places],
            "bodies": {name: self._place_body(body) for name, body in _list(model.getBodySet())},
            "markers": {name: _read(marker.getLocationInGround(state)) for name, marker in _list(model.getMarkerSet())},
        }

    def _place_body(self, body: Any) -> Any:
        X = body.getTransformInGround(self.state)
        return [[[X.R().get(i, j) for j in range(3)] for i in range(3)], _read(X.p())]


def _list(found: Any) -> list[tuple[str, Any]]:
    return [(found.get(k).getName(), found.get(k)) for k in range(found.getSize())]


def _read(vector: Any) -> list[float]:
    return [vector.get(k) for k in range(3)]


if __name__ == "__main__":
    wanted = json.load(sys.stdin)
    peer = Peer(wanted["file"])
    results = [peer.compute(state) for state in wanted["states"]]
    print(json.dumps({"names": list(peer.coordinates), "states": results}))
