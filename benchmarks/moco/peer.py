"""OpenSim Moco's solutions: a script for a Python with OpenSim, whose libraries no process can share with ours.

It reads JSON from stdin: `case`, a key of CASES; `tolerance`; `iterations`, the most; `hessian` and `differences`,
options of Moco; and `guess`: null for Moco's own, or a motion on the same grid (`time`, and values by the paths of
`states`, `controls`, `derivatives`). It prints JSON: `cost`, `status`, `iterations`, and the `seconds` and `processor`
seconds of the solve.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from typing import Any

import opensim as osim

GRAVITY = osim.Vec3(0, -9.80665, 0)


def add_actuator(model: Any, coordinate: Any, force: float) -> None:
    """Add a generalised force, of a control of 1."""
    actuator = osim.CoordinateActuator()
    actuator.setCoordinate(coordinate)
    actuator.setName(f"tau_{coordinate.getName()}")
    actuator.setOptimalForce(force)
    model.addForce(actuator)


def add_link(model: Any, parent: Any, name: str, joint: str, numbers: dict[str, Any]) -> Any:
    """Add a body on a pin; `numbers`: mass, com and moments of inertia about it, place of the joint, force."""
    com, inertia = osim.Vec3(*numbers["com"]), osim.Inertia(*numbers["inertia"])
    body = osim.Body(name, numbers["mass"], com, inertia)
    model.addBody(body)
    zero = osim.Vec3(0)
    pin = osim.PinJoint(joint, parent, osim.Vec3(*numbers["place"]), zero, body, zero, zero)
    coordinate = pin.updCoordinate()
    coordinate.setName(joint)
    model.addJoint(pin)
    add_actuator(model, coordinate, numbers["force"])
    return body


def make_sliding_mass() -> Any:
    model = osim.Model()
    model.set_gravity(osim.Vec3(0))
    body = osim.Body("body", 2.0, osim.Vec3(0), osim.Inertia(0))
    model.addBody(body)
    joint = osim.SliderJoint("slider", model.getGround(), body)
    joint.updCoordinate().setName("position")
    model.addJoint(joint)
    add_actuator(model, joint.updCoordinate(), 1.0)
    return model


def make_squat() -> Any:
    model = osim.Model()
    model.set_gravity(GRAVITY)
    parent = model.getGround()
    for name, joint, mass, com, inertia, place, force in (
        ("shank", "ankle", 7, 0.25, (0.1, 0.01, 0.1), 0, 150),
        ("thigh", "knee", 20, 0.25, (0.3, 0.04, 0.3), 0.43, 300),
        ("trunk", "hip", 45, 0.3, (1.8, 0.5, 1.8), 0.43, 150),
    ):
        own = {"mass": mass, "com": (0, com, 0), "inertia": inertia, "place": (0, place, 0), "force": force}
        parent = add_link(model, parent, name, joint, own)
    return model


def make_hanging() -> Any:
    model = osim.Model()
    model.set_gravity(osim.Vec3(9.81, 0, 0))
    body = osim.Body("body", 0.5, osim.Vec3(0), osim.Inertia(0))
    model.addBody(body)
    joint = osim.SliderJoint("joint", model.getGround(), body)
    joint.updCoordinate().setName("height")
    model.addJoint(joint)
    muscle = osim.DeGrooteFregly2016Muscle()
    muscle.setName("muscle")
    muscle.set_max_isometric_force(30)
    muscle.set_optimal_fiber_length(0.1)
    muscle.set_tendon_slack_length(0.05)
    muscle.set_tendon_strain_at_one_norm_force(0.1)
    muscle.set_ignore_activation_dynamics(False)
    muscle.set_ignore_tendon_compliance(False)
    muscle.set_tendon_compliance_dynamics_mode("implicit")
    muscle.addNewPathPoint("origin", model.updGround(), osim.Vec3(0))
    muscle.addNewPathPoint("insertion", body, osim.Vec3(0))
    model.addForce(muscle)
    return model


def bound(problem: Any, joint: str, coordinate: str, limits: tuple[Any, Any, Any], speed: float = 50) -> None:
    """Bound a coordinate, over time, at the start, at the end, and its speed; it rests at both ends."""
    path = f"/jointset/{joint}/{coordinate}"
    own = osim.MocoInitialBounds(limits[1]), osim.MocoFinalBounds(limits[2])
    problem.setStateInfo(f"{path}/value", osim.MocoBounds(*limits[0]), *own)
    rest = osim.MocoInitialBounds(0), osim.MocoFinalBounds(0)
    problem.setStateInfo(f"{path}/speed", osim.MocoBounds(-speed, speed), *rest)


def state_sliding_mass(problem: Any) -> None:
    problem.setTimeBounds(0, osim.MocoFinalBounds(0.01, 5))
    bound(problem, "slider", "position", ((-5, 5), 0, 1))
    problem.setControlInfo("/forceset/tau_position", osim.MocoBounds(-50, 50))
    problem.addGoal(osim.MocoFinalTimeGoal())


def state_squat(problem: Any) -> None:
    problem.setTimeBounds(0, osim.MocoFinalBounds(1))
    for name, limits in (("ankle", ((-0.5, 0.7), -0.5, 0)), ("knee", ((0, 2), 2, 0)), ("hip", ((-2, 0.5), -2, 0))):
        bound(problem, name, name, limits)
        problem.setControlInfo(f"/forceset/tau_{name}", osim.MocoBounds(-1, 1))
    problem.addGoal(osim.MocoControlGoal("effort"))


def state_hanging(problem: Any) -> None:
    problem.setTimeBounds(0, osim.MocoFinalBounds(0.5))
    bound(problem, "joint", "height", ((0, 0.3), 0.15, 0.14), speed=10)
    problem.setControlInfo("/forceset/muscle", osim.MocoBounds(0.01, 1))
    problem.setStateInfo("/forceset/muscle/activation", osim.MocoBounds(0.01, 1))
    problem.addGoal(osim.MocoControlGoal("effort"))


CASES: dict[str, tuple[Callable[[], Any], Callable[[Any], None], int]] = {  # models, problems, intervals
    "sliding_mass": (make_sliding_mass, state_sliding_mass, 50),
    "squat": (make_squat, state_squat, 25),
    "hanging": (make_hanging, state_hanging, 25),
}


def solve(asked: dict[str, Any]) -> dict[str, Any]:
    """Solve one case."""
    make, state, intervals = CASES[asked["case"]]
    model = make()
    model.finalizeConnections()
    study = osim.MocoStudy()
    problem = study.updProblem()
    problem.setModelAsCopy(model)
    state(problem)
    solver = study.initCasADiSolver()
    solver.set_num_mesh_intervals(intervals)
    if asked["case"] == "hanging":
        solver.set_transcription_scheme("legendre-gauss-radau-3")
        solver.set_interpolate_control_mesh_interior_points(False)
        solver.set_multibody_dynamics_mode("implicit")
    solver.set_optim_hessian_approximation(asked["hessian"])
    solver.set_optim_finite_difference_scheme(asked["differences"])
    solver.set_parallel(0)
    solver.set_verbosity(0)
    solver.set_optim_convergence_tolerance(asked["tolerance"])
    solver.set_optim_constraint_tolerance(asked["tolerance"])
    solver.set_optim_max_iterations(asked["iterations"])
    if asked["guess"] is not None:
        solver.setGuess(read_guess(solver, asked["guess"]))
    wall, own = time.perf_counter(), time.process_time()
    solution = study.solve()
    seconds = {"seconds": time.perf_counter() - wall, "processor": time.process_time() - own}
    solution.unseal()
    return {
        "cost": solution.getObjective(),
        "status": solution.getStatus(),
        "iterations": solution.getNumIterations(),
        **seconds,
    }


def read_guess(solver: Any, given: dict[str, Any]) -> Any:
    """Make Moco's trajectory of a motion on its grid."""
    guess = solver.createGuess("bounds")
    guess.setNumTimes(len(given["time"]))
    guess.setTime(given["time"])
    for path, values in given["states"].items():
        guess.setState(path, values)
    for path, values in given["controls"].items():
        guess.setControl(path, values)
    for path in guess.getDerivativeNames():
        guess.setDerivative(path, given["derivatives"][path])
    return guess


if __name__ == "__main__":
    osim.Logger.setLevelString("Error")
    found = solve(json.load(sys.stdin))
    print("\n" + json.dumps(found))
