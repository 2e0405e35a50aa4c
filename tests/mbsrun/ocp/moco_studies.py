"""Studies of OpenSim Moco, and their costs: a script, since Moco brings a CasADi that no process can share.

It writes CASES as .omoco files, and tables that they track, to the present folder, and prints their costs as
JSON.
"""

from __future__ import annotations

import json
import math
import os
import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import opensim as osim

TOLERANCE = 1e-7
UNSOLVED = ("track",)  # Moco does not converge in 300 iterations


def make_slider() -> Any:
    """Make a mass on a slider, of loose components, as in Moco's first example."""
    model = osim.Model()
    model.setName("sliding_mass")
    model.set_gravity(osim.Vec3(0))
    body = osim.Body("body", 2.0, osim.Vec3(0), osim.Inertia(0))
    model.addComponent(body)
    joint = osim.SliderJoint("slider", model.getGround(), body)
    coordinate = joint.updCoordinate()
    coordinate.setName("position")
    model.addComponent(joint)
    actuator = osim.CoordinateActuator()
    actuator.setCoordinate(coordinate)
    actuator.setName("actuator")
    actuator.setOptimalForce(2)
    model.addComponent(actuator)
    model.finalizeConnections()
    return model


def make_pendulum(links: int) -> Any:
    """Make links on pins, with a torque in each, and a marker at the end."""
    model = osim.Model()
    model.setName("pendulum")
    model.set_gravity(osim.Vec3(0, -9.81, 0))
    parent, zero = model.getGround(), osim.Vec3(0)
    for k in range(links):
        body = osim.Body(f"b{k}", 1.0, zero, osim.Inertia(1))
        model.addBody(body)
        joint = osim.PinJoint(f"j{k}", parent, zero, zero, body, osim.Vec3(-1, 0, 0), zero)
        coordinate = joint.updCoordinate()
        coordinate.setName(f"q{k}")
        model.addJoint(joint)
        actuator = osim.CoordinateActuator()
        actuator.setCoordinate(coordinate)
        actuator.setName(f"tau{k}")
        actuator.setOptimalForce(1)
        model.addForce(actuator)
        parent = body
    model.addMarker(osim.Marker("tip", parent, zero))
    model.finalizeConnections()
    return model


def make_link(name: str) -> tuple[Any, Any, Any]:
    """Make a link on a pin; return the model, its ground and the link."""
    model = osim.Model()
    model.setName(name)
    model.set_gravity(osim.Vec3(0, -9.81, 0))
    ground, zero = model.getGround(), osim.Vec3(0)
    body = osim.Body("upper", 2.0, osim.Vec3(0, -0.13, 0), osim.Inertia(0.03))
    model.addBody(body)
    joint = osim.PinJoint("shoulder", ground, zero, zero, body, zero, zero)
    joint.updCoordinate().setName("shoulder")
    model.addJoint(joint)
    return model, ground, body


def make_arm() -> Any:
    """Make a link on a pin, with three muscles."""
    model, ground, body = make_link("arm")
    for name, strength, side in (("front", 450, 1), ("middle", 300, 1.2), ("back", 400, -1)):
        muscle = osim.DeGrooteFregly2016Muscle()
        muscle.setName(name)
        muscle.set_max_isometric_force(strength)
        muscle.set_optimal_fiber_length(0.11)
        muscle.set_tendon_slack_length(0.06)
        muscle.set_ignore_tendon_compliance(True)
        muscle.set_fiber_damping(0.01)
        muscle.addNewPathPoint(f"{name}_0", ground, osim.Vec3(0.06 * side, 0.05, 0))
        muscle.addNewPathPoint(f"{name}_1", body, osim.Vec3(0.02 * side, -0.12, 0))
        model.addForce(muscle)
    model.finalizeConnections()
    return model


def add_muscle(model: Any, kind: str, name: str, numbers: dict[str, Any], *points: tuple[Any, float, float]) -> None:
    """Add a muscle through points of frames in the plane."""
    muscle = getattr(osim, kind)()
    muscle.setName(name)
    for key, value in numbers.items():
        getattr(muscle, f"set_{key}")(value)
    for k, (frame, x, y) in enumerate(points):
        muscle.addNewPathPoint(f"{name}_{k}", frame, osim.Vec3(x, y, 0))
    model.addForce(muscle)


def make_mixed_arm(name: str, others: Sequence[str]) -> Any:
    """Make a link on a pin, with two muscles, and some with other activation dynamics, or without.

    Those of De Groote have the same time constants: in a process of OpenSim 4.6, all have the ones of the first.
    """
    model, ground, body = make_link(name)
    common = {"optimal_fiber_length": 0.11, "tendon_slack_length": 0.06, "ignore_tendon_compliance": True}
    degroote, millard = "DeGrooteFregly2016Muscle", "Millard2012EquilibriumMuscle"
    lags = {"activation_time_constant": 0.03, "deactivation_time_constant": 0.05}
    for kind, muscle, strength, side, own in (
        (degroote, "front", 450, 1, {"fiber_damping": 0.01, **lags}),
        (degroote, "middle", 300, 1.2, {"fiber_damping": 0.01, **lags}),
        (millard, "upper", 250, 1.4, {"fiber_damping": 0.1}),
        (degroote, "back", 400, -1, {"fiber_damping": 0.01, "ignore_activation_dynamics": True}),
    ):
        if muscle not in ("front", "middle", *others):
            continue
        points = ((ground, 0.06 * side, 0.05), (body, 0.02 * side, -0.12))
        add_muscle(model, kind, muscle, {"max_isometric_force": strength, **common, **own}, *points)
    model.finalizeConnections()
    return model


def make_leg() -> Any:
    """Make a leg of three links, with a reserve torque at each joint and six muscles."""
    model = osim.Model()
    model.setName("squat")
    model.set_gravity(osim.Vec3(0, -9.81, 0))
    zero, frames = osim.Vec3(0), {"ground": model.getGround()}
    parent = model.getGround()
    for name, joint, mass, com, inertia, place in (
        ("shank", "ankle", 7.5, 0.25, 0.1, 0.0),
        ("thigh", "knee", 18.6, 0.24, 0.3, 0.43),
        ("trunk", "hip", 45.0, 0.3, 2.5, 0.41),
    ):
        frames[name] = body = osim.Body(name, mass, osim.Vec3(0, com, 0), osim.Inertia(inertia))
        model.addBody(body)
        pin = osim.PinJoint(joint, parent, osim.Vec3(0, place, 0), zero, body, zero, zero)
        pin.updCoordinate().setName(joint)
        model.addJoint(pin)
        actuator = osim.CoordinateActuator()
        actuator.setCoordinate(pin.updCoordinate())
        actuator.setName(f"reserve_{joint}")
        actuator.setOptimalForce(50)
        model.addForce(actuator)
        parent = body
    common = {"pennation_angle_at_optimal": 0.1, "ignore_tendon_compliance": True, "fiber_damping": 0.01}
    for name, strength, fibre, tendon, first, last in (
        ("soleus", 7000, 0.08, 0.3, ("ground", -0.05, 0.0), ("shank", -0.03, 0.38)),
        ("tibialis", 2500, 0.1, 0.24, ("ground", 0.08, 0.02), ("shank", 0.02, 0.33)),
        ("vasti", 9000, 0.11, 0.13, ("shank", 0.05, 0.36), ("thigh", 0.05, 0.16)),
        ("hamstrings", 5000, 0.12, 0.33, ("shank", -0.03, 0.38), ("trunk", -0.06, -0.03)),
        ("glutei", 4000, 0.15, 0.08, ("thigh", -0.03, 0.25), ("trunk", -0.08, 0.05)),
        ("iliopsoas", 3000, 0.12, 0.12, ("thigh", 0.02, 0.25), ("trunk", 0.05, 0.08)),
    ):
        numbers = {"max_isometric_force": strength, "optimal_fiber_length": fibre, "tendon_slack_length": tendon}
        points = [(frames[frame], x, y) for frame, x, y in (first, last)]
        add_muscle(model, "DeGrooteFregly2016Muscle", name, {**numbers, **common}, *points)
    model.finalizeConnections()
    return model


def begin(name: str, model: Any, final: Any) -> tuple[Any, Any]:
    study = osim.MocoStudy()
    study.setName(name)
    problem = study.updProblem()
    problem.setModel(model)
    problem.setTimeBounds(0, final)
    return study, problem


def finish(study: Any, scheme: str = "hermite-simpson", intervals: int = 20, *, is_linear: bool = True) -> Any:
    solver = study.initCasADiSolver()
    solver.set_num_mesh_intervals(intervals)
    solver.set_transcription_scheme(scheme)
    solver.set_interpolate_control_mesh_interior_points(is_linear)
    solver.set_verbosity(0)
    solver.set_optim_max_iterations(300)
    solver.set_optim_convergence_tolerance(TOLERANCE)
    solver.set_optim_constraint_tolerance(TOLERANCE)
    return study


def slide() -> Any:
    study, problem = begin("sliding_mass", make_slider(), osim.MocoFinalBounds(0.1, 5.0))
    problem.setStateInfo("/slider/position/value", [-5, 5], 0, 1)
    problem.setStateInfo("/slider/position/speed", [-50, 50], 0, 0)
    problem.setControlInfo("/actuator", osim.MocoBounds(-25, 25))
    problem.addGoal(osim.MocoFinalTimeGoal())
    return finish(study)


def swing() -> Any:
    study, problem = begin("swing", make_pendulum(2), 1.5)
    problem.setStateInfo("/jointset/j0/q0/value", [-10, 10], -1.57, 0)
    problem.setStateInfo("/jointset/j1/q1/value", [-10, 10], 0, 0)
    problem.setStateInfoPattern("/jointset/.*/speed", [-50, 50], 0, 0)
    problem.setControlInfoPattern("/forceset/tau.", [-100, 100])
    effort = osim.MocoControlGoal("effort")
    effort.setWeightForControl("/forceset/tau1", 2.0)
    problem.addGoal(effort)
    problem.addGoal(osim.MocoFinalTimeGoal("time", 0.3))
    return finish(study)


def track() -> Any:
    study, problem = begin("track", make_pendulum(1), 1.0)
    problem.setControlInfoPattern("/forceset/tau.", [-200, 200])
    problem.setStateInfoPattern("/jointset/.*/value", [-4, 4])
    goal = osim.MocoStateTrackingGoal("near", 10.0)
    goal.setReference(osim.TableProcessor("states.sto"))
    goal.setWeightForState("/jointset/j0/q0/value", 3.0)
    problem.addGoal(goal)
    problem.addGoal(osim.MocoControlGoal("effort", 1e-2))
    return finish(study, intervals=8)


def follow() -> Any:
    study, problem = begin("follow", make_pendulum(1), 1.0)
    problem.setStateInfo("/jointset/j0/q0/value", [-10, 10], -1)
    problem.setStateInfoPattern("/jointset/.*/speed", [-20, 20], [-3, 0.5])
    problem.setControlInfoPattern("/forceset/tau.", [-200, 200])
    goal = osim.MocoMarkerTrackingGoal("marker", 20.0)
    weights = osim.SetMarkerWeights()
    weights.cloneAndAppend(osim.MarkerWeight("tip", 2.0))
    goal.setMarkersReference(osim.MarkersReference("tip.trc", weights))
    problem.addGoal(goal)
    problem.addGoal(osim.MocoControlGoal("effort", 1e-2))
    return finish(study, intervals=10)


def reach() -> Any:
    study, problem = begin("reach", make_pendulum(1), 1.0)
    problem.setStateInfo("/jointset/j0/q0/value", [-10, 10], -1)
    problem.setStateInfoPattern("/jointset/.*/speed", [-50, 50], 0)
    problem.setControlInfoPattern("/forceset/tau.", [-200, 200])
    place = osim.MocoMarkerFinalGoal("place", 300.0)
    place.setPointName("/markerset/tip")
    place.setReferenceLocation(osim.Vec3(0.9, 0.4, 0))
    problem.addGoal(place)
    slow = osim.MocoSumSquaredStateGoal("slow", 0.5)
    slow.setPattern(".*speed")
    problem.addGoal(slow)
    problem.addGoal(osim.MocoControlGoal("effort", 1e-2))
    return finish(study, "legendre-gauss-radau-3", 6, is_linear=False)


def repeat() -> Any:
    study, problem = begin("repeat", make_pendulum(1), 0.9)
    problem.setStateInfo("/jointset/j0/q0/value", [-4, 4], -1.2)
    problem.setControlInfo("/forceset/tau0", [-100, 100])
    goal = osim.MocoPeriodicityGoal("period")
    goal.addStatePair(osim.MocoPeriodicityGoalPair("/jointset/j0/q0/value"))
    goal.addStatePair(osim.MocoPeriodicityGoalPair("/jointset/j0/q0/speed"))
    pair = osim.MocoPeriodicityGoalPair("/forceset/tau0")
    goal.addControlPair(pair)
    problem.addGoal(goal)
    effort = osim.MocoControlGoal("effort")
    effort.setDivideByDuration(True)
    effort.setExponent(4)
    problem.addGoal(effort)
    return finish(study, intervals=10)


def lift() -> Any:
    """Lift an arm by muscles with different ranges, whose ends the optimum reaches."""
    study, problem = begin("lift", make_arm(), 0.6)
    problem.setStateInfo("/jointset/shoulder/shoulder/value", [-0.5, 2], 0.1, 0.9)
    problem.setStateInfo("/jointset/shoulder/shoulder/speed", [-50, 50], 0, 0)
    problem.setControlInfo("/forceset/front", [0.02, 0.07])
    problem.setControlInfo("/forceset/middle", [0.05, 0.9])
    problem.setStateInfo("/forceset/front/activation", [0.02, 0.06], 0.05)
    problem.setStateInfo("/forceset/middle/activation", [], 0.05)
    problem.addGoal(osim.MocoControlGoal("effort"))
    return finish(study)


def mix(name: str, *others: str) -> Any:
    """Lift an arm by muscles with different activation dynamics."""
    study, problem = begin(name, make_mixed_arm(name, others), 0.6)
    problem.setStateInfo("/jointset/shoulder/shoulder/value", [-0.5, 2], 0.1, 0.9)
    problem.setStateInfo("/jointset/shoulder/shoulder/speed", [-50, 50], 0, 0)
    problem.setStateInfoPattern("/forceset/.*/activation", [0.01, 1], 0.05)
    problem.setControlInfoPattern("/forceset/.*", [0.01, 1])
    problem.addGoal(osim.MocoControlGoal("effort"))
    return finish(study, intervals=10)


def stretch(name: str, mode: str, damping: float, scheme: str, intervals: int, *, is_linear: bool) -> Any:
    """Lift an arm by muscles with elastic tendons, whose forces at the start are given: free ones make flat optima."""
    model, ground, body = make_link(name)
    common = {"optimal_fiber_length": 0.11, "tendon_slack_length": 0.06, "ignore_tendon_compliance": False}
    common |= {"tendon_compliance_dynamics_mode": mode, "fiber_damping": damping, "pennation_angle_at_optimal": 0.1}
    for muscle, strength, side in (("front", 450, 1), ("back", 400, -1)):
        points = ((ground, 0.06 * side, 0.05), (body, 0.02 * side, -0.12))
        add_muscle(model, "DeGrooteFregly2016Muscle", muscle, {"max_isometric_force": strength, **common}, *points)
    model.finalizeConnections()
    study, problem = begin(name, model, 0.6)
    problem.setStateInfo("/jointset/shoulder/shoulder/value", [-0.5, 2], 0.1, 0.9)
    problem.setStateInfo("/jointset/shoulder/shoulder/speed", [-50, 50], 0, 0)
    problem.setStateInfoPattern("/forceset/.*/activation", [0.01, 1], 0.05)
    for muscle, force in (("front", 0.07), ("back", 0.08)):
        problem.setStateInfo(f"/forceset/{muscle}/normalized_tendon_force", [0, 3], force)
    problem.setControlInfoPattern("/forceset/.*", [0.01, 1])
    problem.addGoal(osim.MocoControlGoal("effort"))
    return finish(study, scheme, intervals, is_linear=is_linear)


def squat() -> Any:
    """Stand up by six muscles, whose activations are free at the start and have a least value."""
    study, problem = begin("squat", make_leg(), 1.0)
    for name, limits, first, last in (
        ("ankle", [-1, 0.8], -0.5, 0),
        ("knee", [0, 2.2], 1.6, 0.05),
        ("hip", [-2, 0.5], -1.3, 0),
    ):
        problem.setStateInfo(f"/jointset/{name}/{name}/value", limits, first, last)
        problem.setStateInfo(f"/jointset/{name}/{name}/speed", [-20, 20], 0, 0)
    problem.setStateInfoPattern("/forceset/.*/activation", [0.01, 1])
    problem.setControlInfoPattern("/forceset/reserve.*", [-10, 10])
    effort = osim.MocoControlGoal("effort")
    effort.setWeightForControlPattern("/forceset/reserve.*", 10.0)
    problem.addGoal(effort)
    return finish(study, intervals=10)


CASES: dict[str, Callable[[], Any]] = {
    "sliding_mass": slide,
    "swing": swing,
    "track": track,
    "follow": follow,
    "reach": reach,
    "repeat": repeat,
    "lift": lift,
    "sharp": lambda: mix("sharp", "upper"),
    "direct": lambda: mix("direct", "back"),
    "mixed": lambda: mix("mixed", "upper", "back"),
    "squat": squat,
    "elastic": lambda: stretch("elastic", "implicit", 0.01, "hermite-simpson", 10, is_linear=True),
    "stiff": lambda: stretch("stiff", "explicit", 0.0, "legendre-gauss-radau-3", 6, is_linear=False),
}


def write_tables(folder: Path) -> None:
    """Write angles and places of a marker; they begin before the motion and end after it."""
    times = [-0.5 + 0.02 * k for k in range(101)]
    paths = [f"/jointset/j{k}/q{k}/value" for k in (0,)]
    rows = [(t, -1 + 0.6 * math.sin(3 * t)) for t in times]
    head = f"version=1\nnRows={len(rows)}\nnColumns=2\ninDegrees=no\nendheader\n"
    lines = ["\t".join(["time", *paths]), *("\t".join(map(repr, row)) for row in rows)]
    (folder / "states.sto").write_text(head + "\n".join(lines) + "\n", "utf-8")
    places = [(t, 0.9 + 0.4 * math.sin(2 * t), -1.1 + 0.5 * t, 0.0) for t in times]
    top = [
        "PathFileType\t4\t(X/Y/Z)\ttip.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"50\t50\t{len(places)}\t1\tm\t50\t1\t{len(places)}",
        "Frame#\tTime\ttip\t\t",
        "\t\tX1\tY1\tZ1",
        "",
    ]
    body = ["\t".join([str(k), *map(repr, row)]) for k, row in enumerate(places, 1)]
    (folder / "tip.trc").write_text("\n".join([*top, *body]) + "\n", "utf-8")


def solve_alone(file: Path) -> float:
    """Solve a study in a new process, since OpenSim keeps the time constants of the first one for all that follow."""
    text = f"import opensim as o; o.Logger.setLevelString('off'); s = o.MocoStudy({str(file)!r}).solve(); "
    text += "print(); print(repr(s.getObjective()) if s.success() else 'unsolved')"
    own = {**os.environ, "OPENSIM_MOCO_PARALLEL": "0"}
    run = subprocess.run([sys.executable, "-c", text], env=own, capture_output=True, text=True, check=True)
    return float(run.stdout.splitlines()[-1])


def main() -> None:
    """Write all studies and solve them."""
    folder = Path.cwd()
    write_tables(folder)
    osim.Logger.setLevelString("off")
    costs = {}
    for name, make in CASES.items():
        file = folder / f"{name}.omoco"
        make().printToXML(str(file))
        file.write_text(re.sub(r"\s*<!--.*?-->", "", file.read_text("utf-8"), flags=re.DOTALL), "utf-8")
        if name in UNSOLVED:
            continue
        costs[name] = solve_alone(file)
    print("\n" + json.dumps(costs))


if __name__ == "__main__":
    main()
