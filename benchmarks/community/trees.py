"""Open trees in Exudyn's minimal coordinates, by its explicit integrators.

Joints turn about, or slide along, their own axes. The solver starts at a system that is assembled anew for each motion.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import partial
from typing import Any

import exudyn as exu
import exudyn.utilities as eu
import numpy as np

from benchmarks.loops.motions import EXUDYN, Run, Way
from benchmarks.loops.problems import Problem
from mbsgen.model.tree import Motion, Tree

ADAPTIVE = tuple(10.0**-k for k in range(3, 13))


def list_trees(problem: Problem) -> Iterator[Way]:
    """List Exudyn's ways for an open tree."""
    if problem.tree.loops or problem.springs:
        return

    def solve(tolerance: float) -> Run:
        mbs, node = build(problem)
        settings: Any = exu.SimulationSettings()
        times = settings.timeIntegration
        times.endTime, times.numberOfSteps, times.verboseMode = problem.span, 10, 0
        times.automaticStepSize = True
        times.absoluteTolerance = times.relativeTolerance = tolerance
        times.minimumStepSize = 1e-10
        settings.solutionSettings.writeSolutionToFile = False
        exu.SetWriteToConsole(False)
        begin = time.process_time()
        try:
            done = mbs.SolveDynamic(settings, solverType=exu.DynamicSolverType.DOPRI5, showHints=False)
        except Exception as error:
            raise ArithmeticError(f"Exudyn: {str(error).splitlines()[0]}") from None
        seconds = time.process_time() - begin
        if not done:
            raise ArithmeticError("Exudyn did not reach the end")
        kinds = exu.OutputVariableType
        q, qd = (mbs.GetNodeOutput(node, kind) for kind in (kinds.Coordinates, kinds.Coordinates_t))
        return Run(problem.measure(np.array(q, ndmin=1), np.array(qd, ndmin=1)), seconds, 0)

    yield Way(EXUDYN, "minimal coordinates, DOPRI5", tuple(partial(solve, x) for x in ADAPTIVE))


def build(problem: Problem) -> tuple[Any, Any]:
    """Return a system with a kinematic tree at its start, and the node of its coordinates."""
    tree, joint = problem.tree, exu.JointType
    matrices: Any = exu.Matrix3DList
    vectors: Any = exu.Vector3DList
    container = exu.SystemContainer()
    mbs = container.AddSystem()
    n = len(tree.bodies)
    node = mbs.AddNode(
        eu.NodeGenericODE2(
            numberOfODE2Coordinates=n,
            referenceCoordinates=[0.0] * n,
            initialCoordinates=problem.q.tolist(),
            initialCoordinates_t=problem.qd.tolist(),
        )
    )
    turning = (joint.RevoluteX, joint.RevoluteY, joint.RevoluteZ)
    sliding = (joint.PrismaticX, joint.PrismaticY, joint.PrismaticZ)
    numbers = [_Numbers(tree, k) for k in range(n)]
    mbs.AddObject(
        eu.ObjectKinematicTree(
            nodeNumber=node,
            gravity=_number(tree, tree.gravity),
            jointTypes=[
                (turning if body.joint.motion is Motion.REVOLUTE else sliding)[body.joint.axis] for body in tree.bodies
            ],
            linkParents=[body.parent - 1 for body in tree.bodies],
            jointTransformations=matrices([x.orientation for x in numbers]),
            jointOffsets=vectors([x.position for x in numbers]),
            linkInertiasCOM=matrices([x.inertia for x in numbers]),
            linkCOMs=vectors([x.com for x in numbers]),
            linkMasses=[x.mass for x in numbers],
        )
    )
    mbs.Assemble()
    return mbs, node


def _number(tree: Tree, entries: Any) -> np.ndarray:
    values = {parameter.symbol: parameter.value for parameter in tree.parameters}
    return np.array([float(x.subs(values)) for x in entries])


class _Numbers:
    """The numbers of a body."""

    def __init__(self, tree: Tree, number: int) -> None:
        body = tree.bodies[number]
        self.position, self.com = _number(tree, body.position), _number(tree, body.com)
        self.orientation = np.array([_number(tree, row) for row in body.orientation])
        self.inertia = np.array([_number(tree, row) for row in body.inertia])
        (self.mass,) = _number(tree, (body.mass,))
