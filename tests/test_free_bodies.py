"""The independent program for closed loops, against closed forms and against virtual power."""

from __future__ import annotations

import math
from decimal import Decimal
from typing import Any

import numpy as np
import pytest

from tests.fuzz import mechanisms
from tests.fuzz.absolute import Absolute
from tests.fuzz.free_bodies import FreeBodies, OpenLoopError, independent_rows, rank
from tests.fuzz.kinematics import DECIMALS, fifty_digits

EXACT = 1e-44  # 50 digits, less what a hundred products lose
ROUNDING = 1e-13  # of closed forms in float64
GRAVITY = 9.81
CRANK, COUPLER, ROCKER, GROUND = 0.3, 0.9, 0.7, 1.0  # a four-bar whose crank turns
MASSES = (1.5, 2.0, 0.8)


def _bar(name: str, parent: str, length: float, mass: float, at: float = 0.0) -> dict[str, Any]:
    return {
        "name": name,
        "parent": parent,
        "joint": {"type": "revolute", "axis": "z", "position": [at, 0, 0]},
        "mass": mass,
        "com": [length / 2, 0, 0],
        "inertia": [0, 0, mass * length**2 / 12],
    }


def _four_bar(**more: Any) -> dict[str, Any]:
    rod = _bar("rod", "crank", COUPLER, MASSES[1], CRANK)
    bodies = [_bar("crank", "base", CRANK, MASSES[0]), rod, _bar("rocker", "base", ROCKER, MASSES[2], GROUND)]
    pin = {
        "name": "pin",
        "type": "hinge",
        "from": {"body": "rod", "position": [COUPLER, 0, 0]},
        "to": {"body": "rocker", "position": [ROCKER, 0, 0]},
    }
    return {"name": "four_bar", "gravity": [0, -GRAVITY, 0], "bodies": bodies, "loops": [pin], **more}


def _slider_crank(**more: Any) -> dict[str, Any]:
    piston = {"name": "piston", "joint": {"type": "prismatic", "axis": "x"}, "mass": MASSES[2]}
    rod = _bar("rod", "crank", COUPLER, MASSES[1], CRANK)
    pin = {
        "name": "pin",
        "type": "hinge",
        "from": {"body": "rod", "position": [COUPLER, 0, 0]},
        "to": {"body": "piston"},
    }
    bodies = [_bar("crank", "base", CRANK, MASSES[0]), rod, piston]
    return {"name": "slider_crank", "gravity": [0, -GRAVITY, 0], "bodies": bodies, "loops": [pin], **more}


def _turn(angle: float, rate: float, acceleration: float) -> np.ndarray[Any, Any]:
    """Return exp(i angle), and its first and second time derivatives."""
    unit = complex(math.cos(angle), math.sin(angle))
    return np.array([unit, 1j * rate * unit, (1j * acceleration - rate**2) * unit])


def _close_four_bar(angle: float, rate: float, acceleration: float) -> list[tuple[float, float, float]]:
    """Solve the loop's vector equation for the angles of the rod and the rocker in the base, twice differentiated."""
    crank = CRANK * _turn(angle, rate, acceleration)
    gap = GROUND - crank[0]
    size = abs(gap)
    lift = math.acos((COUPLER**2 + size**2 - ROCKER**2) / (2 * COUPLER * size))
    rod = math.atan2(gap.imag, gap.real) + lift
    end = crank[0] + COUPLER * complex(math.cos(rod), math.sin(rod)) - GROUND
    rocker = math.atan2(end.imag, end.real)
    p, r = COUPLER * _turn(rod, 0, 0)[0], ROCKER * _turn(rocker, 0, 0)[0]
    matrix = np.array([[(1j * p).real, -(1j * r).real], [(1j * p).imag, -(1j * r).imag]])
    rates = np.linalg.solve(matrix, [-crank[1].real, -crank[1].imag])
    rest = crank[2] - rates[0] ** 2 * p + rates[1] ** 2 * r
    accelerations = np.linalg.solve(matrix, [-rest.real, -rest.imag])
    return [(rod, rates[0], accelerations[0]), (rocker, rates[1], accelerations[1])]


def _power(mass: float, inertia: float, centre: np.ndarray[Any, Any], turn: tuple[float, float, float]) -> float:
    """Return dT/dt + dV/dt of a body in the plane."""
    force = mass * (centre[2] + 1j * GRAVITY)
    return float((force * centre[1].conjugate()).real + inertia * turn[1] * turn[2])


@pytest.mark.parametrize("angle", [0.4, 2.0, -1.1])
def test_a_four_bar_moves_as_its_vector_equation_does(angle: float) -> None:
    """Positions, velocities and accelerations; and the crank's torque times its speed is what all energies gain."""
    crank = (angle, 1.7, -2.3)
    rod, rocker = _close_four_bar(*crank)
    program = FreeBodies(_four_bar(driven=["crank"]), {})
    with fifty_digits():
        q = program.close({"crank": angle, "rod": rod[0] - angle + 0.05, "rocker": rocker[0] - 0.05}, ["crank"])
        _, J = program.jacobian(q)
        qd = {"crank": Decimal(crank[1])}
        solved = np.linalg.solve(J[:2, 1:].astype(float), -J[:2, 0].astype(float) * crank[1])
        consistent = program.make_consistent(J, DECIMALS.array([crank[1], *solved]))
        qd = dict(zip(program.names_of_velocities, consistent, strict=True))
        motion = program.solve(q, qd, {}, {}, {"crank": crank[2]}, independent_rows(J))
    assert float(q["rod"] + q["crank"]) == pytest.approx(rod[0], abs=ROUNDING)
    assert float(q["rocker"]) == pytest.approx(rocker[0], abs=ROUNDING)
    assert float(qd["rod"] + qd["crank"]) == pytest.approx(rod[1], rel=100 * ROUNDING)
    assert float(motion.qdd["rod"] + motion.qdd["crank"]) == pytest.approx(rod[2], rel=100 * ROUNDING)
    assert float(motion.qdd["rocker"]) == pytest.approx(rocker[2], rel=100 * ROUNDING)
    elbow = CRANK * _turn(*crank)
    ends = (elbow / 2, elbow + COUPLER / 2 * _turn(*rod), GROUND * np.array([1, 0, 0]) + ROCKER / 2 * _turn(*rocker))
    power = sum(
        _power(mass, mass * length**2 / 12, centre, turn)
        for mass, length, centre, turn in zip(MASSES, (CRANK, COUPLER, ROCKER), ends, (crank, rod, rocker), strict=True)
    )
    assert float(motion.tau["crank"]) * crank[1] == pytest.approx(power, rel=100 * ROUNDING)


@pytest.mark.parametrize("angle", [0.4, 2.0, -1.1])
def test_a_slider_crank_moves_as_its_closed_form_does(angle: float) -> None:
    """x = a cos t + sqrt(b^2 - a^2 sin^2 t), twice differentiated; the torque follows from the energies."""
    a, b, rate, acceleration = CRANK, COUPLER, 1.7, -2.3
    s, c = math.sin(angle), math.cos(angle)
    root = math.sqrt(b**2 - a**2 * s**2)
    slope = -a * s - a**2 * s * c / root
    curvature = -a * c - a**2 * (c**2 - s**2) / root - a**4 * s**2 * c**2 / root**3
    x, xd, xdd = a * c + root, slope * rate, slope * acceleration + curvature * rate**2
    elbow = CRANK * _turn(angle, rate, acceleration)
    slide = np.array([x, xd, xdd])
    arm = (slide - elbow) / b  # exp(i t) of the rod, twice differentiated
    speed = (arm[1] / (1j * arm[0])).real
    turn = (math.atan2(arm[0].imag, arm[0].real), speed, ((arm[2] + speed**2 * arm[0]) / (1j * arm[0])).real)
    program = FreeBodies(_slider_crank(driven=["crank"]), {})
    with fifty_digits():
        q = program.close({"crank": angle, "rod": turn[0] - angle, "piston": x + 0.1}, ["crank"])
        _, J = program.jacobian(q)
        rates = program.make_consistent(J, DECIMALS.array([rate, turn[1] - rate, xd]))
        qd = dict(zip(program.names_of_velocities, rates, strict=True))
        motion = program.solve(q, qd, {}, {}, {"crank": acceleration}, independent_rows(J))
    assert float(q["piston"]) == pytest.approx(x, abs=ROUNDING)
    assert float(motion.qdd["piston"]) == pytest.approx(xdd, rel=100 * ROUNDING)
    power = _power(MASSES[0], MASSES[0] * a**2 / 12, elbow / 2, (angle, rate, acceleration))
    power += _power(MASSES[1], MASSES[1] * b**2 / 12, (elbow + slide) / 2, turn)
    power += MASSES[2] * xdd * xd
    assert float(motion.tau["crank"]) * rate == pytest.approx(power, rel=100 * ROUNDING)


def test_a_mass_on_a_rod_is_a_pendulum() -> None:
    """qdd = -g/L sin q, and the rod carries m (g cos q + L qd^2), as a tension: against the growth of h."""
    mass, length, angle, rate = 1.3, 0.7, 0.6, 1.9
    model = {
        "name": "rod",
        "gravity": [0, 0, -GRAVITY],
        "bodies": [{"name": "bob", "joint": {"type": "free"}, "mass": mass, "inertia": [0.1, 0.1, 0.1]}],
        "loops": [{"name": "rod", "type": "rod", "from": {"body": "base"}, "to": {"body": "bob"}, "length": length}],
    }
    s, c = math.sin(angle), math.cos(angle)
    at = {"x": length * s, "y": 0.0, "z": -length * c, "qx": 0, "qy": 0, "qz": 0, "qw": 1}
    speed = {"x": length * c * rate, "y": 0.0, "z": length * s * rate, "rx": 0, "ry": 0, "rz": 0}
    with fifty_digits():
        program = FreeBodies(model, {})
        q, qd = ({f"bob.{key}": x for key, x in given.items()} for given in (at, speed))
        motion = program.solve(q, qd, {}, {})
        closure = program.close_over(q, qd, motion.qdd)
    acceleration = -GRAVITY / length * s
    expected = length * (acceleration * np.array([c, 0, s]) + rate**2 * np.array([-s, 0, c]))
    assert motion.bodies["bob"].a.astype(float) == pytest.approx(expected, abs=ROUNDING * 10)
    assert float(motion.lam[0]) == pytest.approx(-mass * (GRAVITY * c + length * rate**2), rel=ROUNDING * 10)
    assert abs(closure.h[0]) < 1e-15  # the coordinates are rounded
    assert abs(closure.hdd[0]) < EXACT


def _double_pendulum() -> dict[str, Any]:
    first, second = _bar("first", "base", 0.8, 1.2), _bar("second", "first", 0.5, 0.7, 0.8)
    return {"name": "double", "gravity": [0, -GRAVITY, 0], "bodies": [first, second]}


@pytest.mark.parametrize("kind", ["hinge", "solid"])
def test_a_pendulum_whose_joint_is_a_loop_moves_as_the_tree_does(kind: str) -> None:
    """The second bar is a free body that a loop hangs on the first, directly or by a link without mass."""
    tree, model = _double_pendulum(), _double_pendulum()
    second = model["bodies"][1] | {"parent": "base", "joint": {"type": "floating", "order": "xyz"}}
    loop = {"name": "pin", "type": kind, "from": {"body": "first", "position": [0.8, 0, 0]}, "to": {"body": "second"}}
    link = {"name": "link", "parent": "first", "joint": {"type": "revolute", "axis": "z", "position": [0.8, 0, 0]}}
    if kind == "solid":
        loop["from"] = {"body": "link"}
    model |= {"bodies": [model["bodies"][0], second, *([link] if kind == "solid" else [])], "loops": [loop]}
    with fifty_digits():
        given, program = FreeBodies(tree, {}), FreeBodies(model, {})
        q, qd = {"first": 0.75, "second": -1.0}, {"first": 1.0, "second": 2.0}
        bodies = given.solve(q, qd, {"first": 0.4}, {}).bodies
        wanted = given.move(given.fill(q), given.fill_rates(qd), dict.fromkeys(qd, 0)).bodies["second"]
        start = dict.fromkeys(program.names_of_velocities, 0.0) | {"first": 0.75, "second.rz": -0.25}
        start |= {"second.x": wanted.p[0], "second.y": wanted.p[1], "link": -1.0 if kind == "solid" else 0}
        if kind == "hinge":
            start.pop("link")
        closed = program.close(start, ["first", "second.rz"])
        rates = dict.fromkeys(program.names_of_velocities, 0.0) | {"first": 1.0, "second.rz": 3.0}
        if kind == "solid":
            rates["link"] = 2.0
        rates |= {"second.x": wanted.v[0], "second.y": wanted.v[1]}
        found = program.solve(closed, rates, {"first": 0.4}, {}).bodies
        for name in ("first", "second"):
            assert abs(found[name].a - bodies[name].a).max() < EXACT
            assert abs(found[name].alpha - bodies[name].alpha).max() < EXACT


def test_trees_move_as_virtual_power_demands() -> None:
    """The forces that virtual power finds for the accelerations are the ones that were given, in 50 digits."""
    for seed in (0, 1, 3, 18, 29):  # among them followers, balls, free bodies, screws, rotors and wrenches
        mechanism = mechanisms.draw(seed)
        with fifty_digits():
            program = FreeBodies(mechanism.model, mechanism.parameters)
            power = Absolute(mechanism.model, mechanism.parameters, DECIMALS)
            q, qd, u, w = _state(program, seed)
            motion = program.solve(q, qd, u, w)
            found = power.run(program.fill(q), program.fill_rates(qd), motion.qdd, w)
            needed, given = program.fold(found.Phi), program.fold(found.Q) + DECIMALS.array([*u.values()])
            assert abs(needed - given).max() < EXACT * max(1, float(found.size))


def _state(
    program: FreeBodies, seed: int
) -> tuple[dict[str, float], dict[str, float], dict[str, float], dict[str, Any]]:
    source = np.random.default_rng(seed)
    names = program.names_of_velocities
    q = {name: source.uniform(-1, 1) for name in program.names_of_coordinates}
    qd, u = ({name: source.uniform(-1, 1) for name in names} for _ in range(2))
    w = {
        f"{x['name']}.{key}": source.uniform(-1, 1, 3)
        for x in program.model.get("wrenches", ())
        for key in ("force", "moment")
        if x[key] == "input"
    }
    return q, qd, u, w


def test_a_loop_out_of_reach_stays_open() -> None:
    """The program does not take a pose for closed that is not."""
    model = _four_bar()
    model["bodies"][2]["joint"]["position"] = [5, 0, 0]
    with fifty_digits(), pytest.raises(OpenLoopError):
        FreeBodies(model, {}).close({"crank": 0.1, "rod": 0.2, "rocker": 0.3})


def test_a_planar_loop_closed_in_space_has_three_equations_too_many() -> None:
    """A hinge between bodies that move in a plane: two of its five equations restrict the motion."""
    with fifty_digits():
        program = FreeBodies(_four_bar(), {})
        q = program.close({"crank": 0.4, "rod": 0.6, "rocker": 1.4})
        assert rank(program.jacobian(q)[1]) == 2
        assert independent_rows(program.jacobian(q)[1]) == [0, 1]


def test_energies_change_by_the_power_of_forces_alone() -> None:
    """dT/dt + dV/dt = u . qd: forces of loops have no power."""
    with fifty_digits():
        program = FreeBodies(_four_bar(), {})
        q = program.close({"crank": 0.4, "rod": 0.6, "rocker": 1.4})
        J = program.jacobian(q)[1]
        rates = program.make_consistent(J, DECIMALS.array([1.0, -0.4, 0.9]))
        qd, u = dict(zip(program.names_of_velocities, rates, strict=True)), {"crank": 0.7, "rod": -0.2, "rocker": 1.1}
        motion = program.solve(q, qd, u, {}, kept=independent_rows(J))
        gain = Decimal(0)
        for body, length, mass in zip(program.model["bodies"], (CRANK, COUPLER, ROCKER), MASSES, strict=True):
            centre = motion.bodies[body["name"]].carry(DECIMALS.array([length / 2, 0, 0]))
            gain += Decimal(mass) * (centre.a - program.gravity) @ centre.v
            gain += program.inertia(body)[2, 2] * centre.alpha[2] * centre.om[2]
        power = sum(Decimal(u[name]) * qd[name] for name in qd)
        assert abs(gain - power) < EXACT * 10
