"""OpenSim Moco's solutions of problems that ship: a script, since Moco brings a CasADi that no process can share.

It prints, as JSON, the least time and the least effort of a sliding mass, values of muscle curves, and the cost of a
lift by two muscles without activation dynamics.
"""

from __future__ import annotations

import json
from typing import Any

import opensim as osim


def make_slider() -> Any:
    """Make a mass of 2 kg on a slider, with a force of up to 50 N."""
    model = osim.Model()
    model.set_gravity(osim.Vec3(0, 0, 0))
    body = osim.Body("body", 2.0, osim.Vec3(0), osim.Inertia(0))
    model.addBody(body)
    joint = osim.SliderJoint("slider", model.getGround(), body)
    coordinate = joint.updCoordinate()
    coordinate.setName("position")
    model.addJoint(joint)
    actuator = osim.CoordinateActuator()
    actuator.setCoordinate(coordinate)
    actuator.setName("actuator")
    actuator.setOptimalForce(1)
    model.addForce(actuator)
    model.finalizeConnections()
    return model


def solve_slider(goal: Any, times: Any) -> float:
    """Move the mass by 1 m, from rest to rest."""
    study = osim.MocoStudy()
    problem = study.updProblem()
    problem.setModel(make_slider())
    problem.setTimeBounds(0, times)
    problem.setStateInfo(
        "/jointset/slider/position/value", osim.MocoBounds(-5, 5), osim.MocoInitialBounds(0), osim.MocoFinalBounds(1)
    )
    problem.setStateInfo("/jointset/slider/position/speed", [-50, 50], 0, 0)
    problem.setControlInfo("/forceset/actuator", osim.MocoBounds(-50, 50))
    problem.addGoal(goal)
    return finish(study)


def finish(study: Any) -> float:
    """Solve, and return the cost."""
    solver = study.initCasADiSolver()
    solver.set_num_mesh_intervals(50)
    solver.set_verbosity(0)
    solver.set_optim_convergence_tolerance(1e-6)
    solver.set_optim_constraint_tolerance(1e-6)
    solution = study.solve()
    assert solution.success()
    return float(solution.getObjective())


def list_curves() -> list[tuple[float, float, float]]:
    """List lengths with the multipliers of active and passive force, and of the velocity x - 1."""
    muscle = osim.DeGrooteFregly2016Muscle()
    muscle.finalizeFromProperties()
    lengths = [0.45 + 0.05 * k for k in range(20)]
    return [
        (
            x,
            muscle.calcActiveForceLengthMultiplier(x) * muscle.calcForceVelocityMultiplier(x - 1),
            muscle.calcPassiveForceMultiplier(x),
        )
        for x in lengths
    ]


def make_arm() -> Any:
    """Make the arm of models/muscles/arm.yaml in the plane of x and y."""
    model = osim.Model()
    model.set_gravity(osim.Vec3(0, -9.81, 0))
    ground, zero = model.getGround(), osim.Vec3(0)
    upper = osim.Body("upper", 2.0, osim.Vec3(0, -0.13, 0), osim.Inertia(0.015, 0.002, 0.015))
    fore = osim.Body("fore", 1.5, osim.Vec3(0, -0.16, 0), osim.Inertia(0.012, 0.001, 0.012))
    for body in (upper, fore):
        model.addBody(body)
    joints = (
        osim.PinJoint("shoulder", ground, zero, zero, upper, zero, zero),
        osim.PinJoint("elbow", upper, osim.Vec3(0, -0.3, 0), zero, fore, zero, zero),
    )
    for joint in joints:
        joint.updCoordinate().setName(joint.getName())
        model.addJoint(joint)
    for name, values, points in (
        ("deltoid", (450, 0.11, 0.06), ((ground, 0.06, 0.05), (upper, 0.02, -0.12))),
        ("brachialis", (300, 0.13, 0.15), ((upper, 0.02, -0.05), (fore, 0.02, -0.05))),
    ):
        muscle = osim.DeGrooteFregly2016Muscle()
        muscle.setName(name)
        muscle.set_max_isometric_force(values[0])
        muscle.set_optimal_fiber_length(values[1])
        muscle.set_tendon_slack_length(values[2])
        muscle.set_ignore_tendon_compliance(True)
        muscle.set_ignore_activation_dynamics(True)
        muscle.set_fiber_damping(0)
        for i, (body, x, y) in enumerate(points):
            muscle.addNewPathPoint(f"{name}_{i}", body, osim.Vec3(x, y, 0))
        model.addForce(muscle)
    model.finalizeConnections()
    return model


def solve_lift() -> float:
    """Lift the arm in 0.6 s at the least integral of squared activations."""
    study = osim.MocoStudy()
    problem = study.updProblem()
    problem.setModel(make_arm())
    problem.setTimeBounds(0, 0.6)
    for name, first, last, limits in (("shoulder", 0.1, 0.9, (-0.5, 2)), ("elbow", 0.2, 1.2, (0, 2.4))):
        problem.setStateInfo(f"/jointset/{name}/{name}/value", list(limits), first, last)
        problem.setStateInfo(f"/jointset/{name}/{name}/speed", [-50, 50], 0, 0)
    for name in ("deltoid", "brachialis"):
        problem.setControlInfo(f"/forceset/{name}", [0.01, 1])
    problem.addGoal(osim.MocoControlGoal("effort"))
    return finish(study)


if __name__ == "__main__":
    osim.Logger.setLevelString("Error")
    found = {
        "time": solve_slider(osim.MocoFinalTimeGoal(), osim.MocoFinalBounds(0, 5)),
        "effort": solve_slider(osim.MocoControlGoal("effort"), osim.MocoFinalBounds(1)),
        "curves": list_curves(),
        "lift": solve_lift(),
    }
    print("\n" + json.dumps(found))
