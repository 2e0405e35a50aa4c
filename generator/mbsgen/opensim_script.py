"""OpenSim's numbers of a model at some states: a script for a Python that has OpenSim. It imports nothing of mbsgen.

It reads JSON from stdin: `file`, and `states` of coordinates `q`, speeds `u` and accelerations `udot` by name, and of
`controls`, a list for each actuator that is no muscle. It
prints JSON: `names` of coordinates; for each state `M` and `tau` in their order, `bodies` and `markers` by their places
in the ground, and `paths`: lengths, rates and moment arms of all muscles and springs. Paths around ellipsoids and tori
have `changes`, differences of their lengths along speeds, which are not OpenSim's rates. Forces act only if they are
passive ones of coordinates, contacts, ligaments, bushings, forces between two points, or actuators of bodies: `acting`
lists these, without forces of coordinates and contacts.
"""

from __future__ import annotations

import importlib
import json
import sys
from typing import Any

LINES = (
    "Ligament",
    "Blankevoort1991Ligament",
    "PointToPointSpring",
    "ExpressionBasedPointToPointForce",
    "PointToPointActuator",
    "PathActuator",
    "BushingForce",
    "FunctionBasedBushingForce",
    "ExpressionBasedBushingForce",
    "TorqueActuator",
    "PointActuator",
    "BodyActuator",
    "PrescribedForce",
)
CONTACTS = ("SmoothSphereHalfSpaceForce", "HuntCrossleyForce")
ACTING = ("SpringGeneralizedForce", "CoordinateLimitForce", "ExpressionBasedCoordinateForce", *CONTACTS, *LINES)
ALONG = ("Muscle", "PathSpring", "PathActuator", "Ligament", "Blankevoort1991Ligament")
SHAPES = ("WrapEllipsoid", "WrapTorus")
STEP = 1e-4  # s, of differences of lengths: OpenSim's have jumps of 1e-7 m
FAR = 1e-3  # rad or m: beside this, a coordinate that a coupling moves is at another place


class Peer:
    """A model in OpenSim."""

    def __init__(self, osim: Any, file: str) -> None:
        self.osim = osim
        osim.Logger.setLevelString("off")
        self.model = osim.Model(file)
        forces = self.model.updForceSet()
        self.paths: dict[str, Any] = {}
        self.acting: list[str] = []
        for k in range(forces.getSize()):
            force = forces.get(k)
            kind = force.getConcreteClassName()
            force.set_appliesForce(kind in ACTING)
            cast = next((x for kind in ALONG if (x := getattr(osim, kind).safeDownCast(force)) is not None), None)
            if kind in LINES:
                self.acting.append(force.getName())
            if cast is not None:
                self.paths[force.getName()] = cast
        self.state = self.model.initSystem()
        found = self.model.getCoordinateSet()
        self.coordinates = {found.get(k).getName(): found.get(k) for k in range(found.getSize())}
        for coordinate in self.coordinates.values():
            coordinate.setLocked(self.state, False)
            coordinate.setClamped(self.state, False)
        self.places = [self._find_place(coordinate) for coordinate in self.coordinates.values()]

    def _find_place(self, coordinate: Any) -> int:
        """Return the number of the speed of a coordinate."""
        state = self.osim.State(self.state)
        for k in range(state.getNU()):
            state.updU()[k] = 0.0
        coordinate.setSpeedValue(state, 1.0)
        (place,) = [k for k in range(state.getNU()) if state.getU()[k] != 0]
        return int(place)

    def compute(self, given: dict[str, Any]) -> dict[str, Any]:
        """Compute everything at a state."""
        osim, model, state = self.osim, self.model, self.state
        for name, value in given["q"].items():
            self.coordinates[name].setValue(state, value, False)
        udot = osim.Vector(state.getNU(), 0.0)
        for name, place in zip(self.coordinates, self.places):  # noqa: B905  # of any Python
            state.updU()[place] = given["u"].get(name, 0.0)
            udot[place] = given["udot"].get(name, 0.0)
        model.realizeVelocity(state)
        self._control(given.get("controls", {}))
        M = osim.Matrix()
        model.getMatterSubsystem().calcM(state, M)
        tau = osim.InverseDynamicsSolver(model).solve(state, udot)
        return {
            "M": [[M.get(i, j) for j in self.places] for i in self.places],
            "tau": [tau.get(i) for i in self.places],
            "bodies": {name: _read(body.getPositionInGround(state)) for name, body in _list(model.getBodySet())},
            "markers": {name: _read(marker.getLocationInGround(state)) for name, marker in _list(model.getMarkerSet())},
            "paths": {name: self._measure(path, given["along"]) for name, path in self.paths.items()},
        }

    def _control(self, given: dict[str, list[float]]) -> None:
        """Set the controls of actuators; all others are 0."""
        controls = self.osim.Vector(self.model.getNumControls(), 0.0)
        for name, values in given.items():
            actuator = self.osim.Actuator.safeDownCast(self.model.getForceSet().get(name))
            if actuator is not None:
                actuator.setControls(self.osim.Vector(values), controls)
        self.model.setControls(self.state, controls)

    def _measure(self, force: Any, along: list[dict[str, float]]) -> dict[str, Any]:
        """Return the length of a path, its rate, and its rate along other speeds."""
        path, model = self.osim.GeometryPath.safeDownCast(force.getPath()), self.model
        length, rate = path.getLength(self.state), path.getLengtheningSpeed(self.state)
        wraps = path.getWrapSet()
        shaped = any(wraps.get(k).getWrapObject().getConcreteClassName() in SHAPES for k in range(wraps.getSize()))
        slopes, changes = [], []
        for speeds in along:
            state = self.osim.State(self.state)
            for name, place in zip(self.coordinates, self.places):  # noqa: B905
                state.updU()[place] = speeds.get(name, 0.0)
            model.realizeVelocity(state)
            slopes.append(path.getLengtheningSpeed(state))
            if shaped:
                ends = [self._move(path, state, sign * STEP) for sign in (1, -1)]
                changes.append((ends[0] - ends[1]) / (2 * STEP))
        found = {"length": length, "rate": rate, "slopes": slopes}
        return {**found, "changes": changes} if shaped else found

    def _move(self, path: Any, state: Any, time: float) -> float:
        """Return the length of a path after a time at the speeds of a state."""
        moved = self.osim.State(state)
        for k in range(state.getNQ()):
            moved.updQ()[k] = state.getQ()[k] + time * state.getQDot()[k]
        self.model.realizePosition(moved)
        return float(path.getLength(moved))


def _list(found: Any) -> list[tuple[str, Any]]:
    return [(found.get(k).getName(), found.get(k)) for k in range(found.getSize())]


def _read(vector: Any) -> list[float]:
    return [vector.get(k) for k in range(3)]


def main() -> None:
    """Answer the states of stdin."""
    wanted = json.load(sys.stdin)
    peer = Peer(importlib.import_module("opensim"), wanted["file"])
    results = [peer.compute(state) for state in wanted["states"]]
    print("\n" + json.dumps({"names": list(peer.coordinates), "acting": peer.acting, "states": results}))


if __name__ == "__main__":
    main()
