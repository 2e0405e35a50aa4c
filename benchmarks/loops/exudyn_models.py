"""Trees with loops in Exudyn's absolute coordinates, and their motions by its implicit integrators.

Mechanisms in the plane x, y have 2-D bodies and joints, as in Exudyn's own example of four-bars; others have 3-D ones
with Euler parameters, as in its example of Bricard's mechanism, whose redundant joint needs a dense solver that ignores
what is singular.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import exudyn as exu
import exudyn.utilities as eu
import numpy as np
from numpy.typing import NDArray

from benchmarks.loops.mechanism import Law, Spring, list_kinds
from benchmarks.loops.placement import Place, place_bodies
from mbsgen.model.tree import Motion, Tree

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Manner:
    """How to integrate: generalised alpha, or the trapezoidal rule on velocities' constraints."""

    steps: int
    trapezoidal: bool = False
    radius: float = 0.9  # spectral, of generalised alpha
    is_redundant: bool = False


@dataclass(frozen=True)
class Outcome:
    """The end of a motion."""

    position: Array  # of the bodies' centres of mass, a row each
    velocity: Array
    angle: Array  # of 2-D bodies, total; else nothing
    omega: Array
    seconds: float  # of the processor


def is_flat(tree: Tree) -> bool:
    """Return whether all joints turn about z."""
    places = place_bodies(tree, [0.0] * len(tree.bodies), [0.0] * len(tree.bodies))
    turning = all(body.joint.motion is Motion.REVOLUTE for body in tree.bodies)
    return turning and all(abs(abs(place.joint[2]) - 1) < 1e-12 for place in places[1:])


class Plane:
    """A mechanism in the plane."""

    def __init__(
        self, tree: Tree, q: Sequence[float], qd: Sequence[float], laws: Sequence[Law] = (), ties: Sequence[Spring] = ()
    ) -> None:
        """Make bodies, joints, loops, the forces of constant laws, and springs."""
        self.container = exu.SystemContainer()
        self.mbs = self.container.AddSystem()
        self.tree, self.places = tree, place_bodies(tree, q, qd)
        values = {parameter.symbol: parameter.value for parameter in tree.parameters}
        self.gravity = [float(x.subs(values)) for x in tree.gravity]
        self.angles = self._sum(q)
        self.bodies = [self.mbs.AddObject(eu.ObjectGround()), *map(self._add_body, range(1, len(self.places)))]
        for number, body in enumerate(tree.bodies, 1):
            point = self.places[number].origin
            self._join(body.parent, number, point)
        for loop in tree.loops:
            place = self.places[loop.first.body]
            offset = np.array([float(x.subs(values)) for x in loop.first.position])
            self._join(loop.first.body, loop.second.body, place.origin + place.axes @ offset)
        for law in laws:
            if law.k == 0 and law.f != 0:
                self._drive(law.joint + 1, law.f)
        for tie in ties:
            self._tie(tie)
        self.mbs.Assemble()

    def _sum(self, q: Sequence[float]) -> list[float]:
        angles = [0.0]
        for body, x in zip(self.tree.bodies, q, strict=True):
            angles.append(angles[body.parent] + x)
        return angles

    def _add_body(self, number: int) -> Any:
        place = self.places[number]
        node = self.mbs.AddNode(
            eu.NodeRigidBody2D(
                referenceCoordinates=[*place.com[:2], self.angles[number]],
                initialVelocities=[*place.velocity[:2], place.omega[2]],
            )
        )
        body = self.mbs.AddObject(
            eu.RigidBody2D(nodeNumber=node, physicsMass=place.mass, physicsInertia=place.inertia[2, 2])
        )
        if any(self.gravity):
            mass = self.mbs.AddMarker(eu.MarkerBodyMass(bodyNumber=body))
            self.mbs.AddLoad(eu.LoadMassProportional(markerNumber=mass, loadVector=self.gravity))
        return body

    def _mark(self, number: int, point: Array) -> Any:
        place = self.places[number]
        local = self.places[number].axes.T @ (point - place.com)
        return self.mbs.AddMarker(eu.MarkerBodyPosition(bodyNumber=self.bodies[number], localPosition=list(local)))

    def _join(self, first: int, second: int, point: Array) -> None:
        self.mbs.AddObject(eu.RevoluteJoint2D(markerNumbers=[self._mark(first, point), self._mark(second, point)]))

    def _drive(self, number: int, torque: float) -> None:
        marker = self.mbs.AddMarker(eu.MarkerBodyRigid(bodyNumber=self.bodies[number]))
        self.mbs.AddLoad(eu.LoadTorqueVector(markerNumber=marker, loadVector=[0, 0, torque]))

    def _tie(self, tie: Spring) -> None:
        ends = [self.places[k].origin + self.places[k].axes @ np.array(p) for k, p in zip(*_pairs(tie), strict=True)]
        markers = [self._mark(k, p) for k, p in zip(tie.bodies, ends, strict=True)]
        self.mbs.AddObject(
            eu.SpringDamper(
                markerNumbers=markers, stiffness=tie.stiffness, damping=tie.damping, referenceLength=tie.slack
            )
        )

    def run(self, span: float, manner: Manner) -> Outcome:
        """Integrate. Raises ArithmeticError."""
        seconds = solve(self.mbs, span, manner)
        read, kinds = self.mbs.GetObjectOutputBody, exu.OutputVariableType
        bodies = self.bodies[1:]
        position = np.array([read(b, kinds.Position, [0, 0, 0]) for b in bodies])
        nodes = [self.mbs.GetObject(b)["nodeNumber"] for b in bodies]
        angle = np.array([self.mbs.GetNodeOutput(n, kinds.Coordinates)[2] for n in nodes])
        omega = np.array([self.mbs.GetNodeOutput(n, kinds.Coordinates_t)[2] for n in nodes])
        velocity = np.array([read(b, kinds.Velocity, [0, 0, 0]) for b in bodies])
        return Outcome(position, velocity, angle + np.array(self.angles[1:]), omega, seconds)


def _pairs(tie: Spring) -> tuple[tuple[int, int], tuple[tuple[float, float, float], tuple[float, float, float]]]:
    return tie.bodies, tie.points


class Space:
    """A mechanism in space."""

    def __init__(self, tree: Tree, q: Sequence[float], qd: Sequence[float], ties: Sequence[Spring] = ()) -> None:
        """Make bodies, joints, loops and springs."""
        self.container = exu.SystemContainer()
        self.mbs = self.container.AddSystem()
        self.tree, self.places = tree, place_bodies(tree, q, qd)
        values = {parameter.symbol: parameter.value for parameter in tree.parameters}
        gravity = [float(x.subs(values)) for x in tree.gravity]
        self.bodies = [self.mbs.AddObject(eu.ObjectGround())]
        self.bodies += [self._add_body(place, gravity) for place in self.places[1:]]
        for number, body in enumerate(tree.bodies, 1):
            place, pair = self.places[number], [self.bodies[body.parent], self.bodies[number]]
            arguments = {"bodyNumbers": pair, "position": list(place.origin), "axis": list(place.joint)}
            if body.joint.motion is Motion.REVOLUTE:
                self.mbs.CreateRevoluteJoint(**arguments)
            else:
                self.mbs.CreatePrismaticJoint(**arguments)
        for loop, kind in zip(tree.loops, list_kinds(tree), strict=True):
            end = loop.first
            place = self.places[end.body]
            point = place.origin + place.axes @ np.array([float(x.subs(values)) for x in end.position])
            axes = place.axes @ np.array([[float(x.subs(values)) for x in row] for row in end.axes])
            free = {"point": [0, 0, 0], "axis": [1, 1, 0], "frame": [1, 1, 1]}[kind]
            self.mbs.CreateGenericJoint(
                bodyNumbers=[self.bodies[loop.first.body], self.bodies[loop.second.body]],
                position=list(point),
                rotationMatrixAxes=axes,
                constrainedAxes=[1, 1, 1, *free],
                useGlobalFrame=True,
            )
        for tie in ties:
            markers = [
                self.mbs.AddMarker(
                    eu.MarkerBodyPosition(
                        bodyNumber=self.bodies[k],
                        localPosition=list(
                            np.array(p) - self.places[k].axes.T @ (self.places[k].com - self.places[k].origin)
                        ),
                    )
                )
                for k, p in zip(tie.bodies, tie.points, strict=True)
            ]
            self.mbs.AddObject(
                eu.SpringDamper(
                    markerNumbers=markers, stiffness=tie.stiffness, damping=tie.damping, referenceLength=tie.slack
                )
            )
        self.mbs.Assemble()

    def _add_body(self, place: Place, gravity: Sequence[float]) -> Any:
        inertia = eu.RigidBodyInertia(mass=place.mass, com=np.zeros(3), inertiaTensor=place.inertia)
        return self.mbs.CreateRigidBody(
            inertia=inertia,
            nodeType=exu.NodeType.RotationEulerParameters,
            referencePosition=list(place.com),
            referenceRotationMatrix=place.axes,
            initialVelocity=list(place.velocity),
            initialAngularVelocity=list(place.omega),
            gravity=list(gravity),
        )

    def run(self, span: float, manner: Manner) -> Outcome:
        """Integrate. Raises ArithmeticError."""
        seconds = solve(self.mbs, span, manner)
        read, kinds = self.mbs.GetObjectOutputBody, exu.OutputVariableType
        position = np.array([read(b, kinds.Position, [0, 0, 0]) for b in self.bodies[1:]])
        velocity = np.array([read(b, kinds.Velocity, [0, 0, 0]) for b in self.bodies[1:]])
        return Outcome(position, velocity, np.zeros(0), np.zeros(0), seconds)


def solve(mbs: Any, span: float, manner: Manner) -> float:
    """Integrate a system; return the processor's seconds. Raises ArithmeticError."""
    settings: Any = exu.SimulationSettings()
    times = settings.timeIntegration
    times.numberOfSteps, times.endTime, times.verboseMode = manner.steps, span, 0
    times.newton.useModifiedNewton = True
    times.newton.relativeTolerance = times.newton.absoluteTolerance = 1e-10
    times.generalizedAlpha.computeInitialAccelerations = True
    times.generalizedAlpha.spectralRadius = manner.radius
    times.generalizedAlpha.useIndex2Constraints = manner.trapezoidal
    times.generalizedAlpha.useNewmark = manner.trapezoidal
    settings.solutionSettings.writeSolutionToFile = False
    settings.solutionSettings.sensorsWritePeriod = span
    settings.displayComputationTime = False
    if manner.is_redundant:
        settings.linearSolverType = exu.LinearSolverType.EigenDense
        settings.linearSolverSettings.ignoreSingularJacobian = True
    exu.SetWriteToConsole(False)
    begin = time.process_time()
    try:
        if not mbs.SolveDynamic(settings, showHints=False):
            raise ArithmeticError("Exudyn did not reach the end")
    except Exception as error:
        raise ArithmeticError(f"Exudyn: {str(error).splitlines()[0]}") from None
    return time.process_time() - begin
