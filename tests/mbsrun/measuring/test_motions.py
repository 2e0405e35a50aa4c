"""Charts of simulation: the reference against a closed form, errors against orders, failures kept."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.special import ellipj, ellipk

from mbsrun.external import Mechanism
from mbsrun.measuring import motions
from mbsrun.measuring.charts import draw_motions
from mbsrun.measuring.motions import EXTENT, Course, MotionScope, NoReferenceError, draw_course
from mbsrun.measuring.points import MotionPoint
from mbsrun.measuring.store import Store
from mbsrun.models import find_folder
from mbsrun.simulation.drive import hold
from mbsrun.simulation.integration.methods import Formulation

PENDULUM = """
name: pendulum
gravity: [0, 0, -9.81]
bodies:
  - name: rod
    joint: {name: q1, type: revolute, axis: y, actuated: false}
    mass: 1
    com: [0, 0, -1]
    inertia: [0, 0, 0]
"""
HELD = """
name: held
gravity: [0, 0, -9.81]
bodies:
  - {name: y, joint: {type: prismatic, axis: y, actuated: false}}
  - {name: z, parent: y, joint: {type: prismatic, axis: z, actuated: false}, mass: 1}
loops:
  - {name: rod, type: rod, length: 1, from: {body: base}, to: {body: z}}
assembly: {y: 0.6, z: -0.8}
independent: [y]
"""
DURATION = 2.0


def quiet(*_: object) -> None:
    """Ignore progress."""


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory: pytest.TempPathFactory) -> Mechanism:
    """A point mass on a rod of 1 m: Phi = qdd + 9.81 sin q."""
    path = tmp_path_factory.mktemp("pendulum") / "pendulum.yaml"
    path.write_text(PENDULUM, encoding="utf-8")
    return Mechanism(find_folder(path, EXTENT))


def swing(pendulum: Mechanism) -> Course:
    """Release it from 1 rad."""
    return replace(draw_course(pendulum, DURATION), q=np.array([1.0]), qd=np.array([0.0]))


def test_the_reference_is_as_accurate_as_it_says(pendulum: Mechanism) -> None:
    """sin(q/2) = k sn(K - w t), with k = sin(1/2), w^2 = g / l."""
    standard = motions.find_standard(swing(pendulum))
    k, w = np.sin(0.5), np.sqrt(9.81)
    sn, cn, _, _ = ellipj(ellipk(k**2) - w * DURATION, k**2)
    q = 2 * np.arcsin(k * sn)
    exact = np.array([q, -2 * k * w * cn])
    assert np.abs(standard.state - exact).max() < 1e-11
    assert standard.accuracy < 1e-11


def test_errors_fall_with_the_order_of_the_method(pendulum: Mechanism, tmp_path: Path) -> None:
    """Half the step: 1/16 of the error by rk4 and by Gauss collocation with two stages, 1/2 by symplectic Euler."""
    course = swing(pendulum)
    standard = motions.find_standard(course)
    orders = {"rk4": 4, "gauss": 4, "symplectic-euler": 1}
    scope = MotionScope(tuple((method, Formulation.EXP2) for method in orders), (8, 16), (8, 16), (), 1)
    store = Store(tmp_path / "simulation.jsonl", MotionPoint)
    points = motions.measure_motions(course, standard, scope, store, quiet)
    for method, order in orders.items():
        coarse, fine = (p.error for p in points if p.method == method)
        assert coarse is not None
        assert fine is not None
        assert np.log2(coarse / fine) == pytest.approx(order, abs=0.35)
    again = motions.measure_motions(course, standard, scope, Store(tmp_path / "simulation.jsonl", MotionPoint), quiet)
    assert again == points


def test_motions_that_stop_are_points_and_are_drawn(tmp_path: Path) -> None:
    """Explicit Euler on a spring of 1e9 rad/s^2 overflows: no error, no time, but a finding."""
    path = tmp_path / "stiff.yaml"
    path.write_text(PENDULUM.replace("axis: y,", "axis: y, stiffness: 1e9,"), encoding="utf-8")
    mechanism = Mechanism(find_folder(path, EXTENT))
    course = replace(swing(mechanism), duration=2.0)
    standard = motions.Standard(np.zeros(2), 1e-12, 40, 2.0)
    scope = MotionScope((("euler", Formulation.EXP2), ("radau-iia", Formulation.IMPL)), (10,), (10,), (), 1)
    store = Store(tmp_path / "simulation.jsonl", MotionPoint)
    failed, done = motions.measure_motions(course, standard, scope, store, quiet)
    assert (failed.seconds, failed.error) == (None, None)
    assert "stopped at t" in failed.finding
    assert not done.finding
    assert all(path.stat().st_size > 5_000 for path in draw_motions([failed, done], standard, tmp_path))


def test_a_motion_without_a_reference_is_refused(locked: Path) -> None:
    """Started in its lock, a Cardan joint without mass has no accelerations."""
    mechanism = Mechanism(find_folder(locked, EXTENT))
    course = replace(draw_course(mechanism, 1.0), q=np.array([0.0, np.pi / 2, 0.0]), qd=np.array([1.0, 1.0, 1.0]))
    with pytest.raises(NoReferenceError, match="there is no reference"):
        motions.find_standard(course)


def test_motions_with_loops_are_measured_by_the_methods_that_take_them(tmp_path: Path) -> None:
    """A rod that a loop holds by a second pin is the pendulum: y = sin(q), z = -cos(q), with a point mass there."""
    path = tmp_path / "model.yaml"
    path.write_text(HELD, encoding="utf-8")
    course = draw_course(Mechanism(find_folder(path, EXTENT)), 0.5)
    assert np.hypot(*course.q) == pytest.approx(1.0, abs=1e-9)
    standard = motions.find_standard(course)
    assert standard.accuracy < 1e-10
    assert standard.title.startswith("Radau")
    families = (("rk4", Formulation.EXP2), ("gauss", Formulation.IMPL), ("radau-iia", Formulation.EXP1))
    scope = MotionScope(families, (4,), (16,), (), 1)
    points = motions.measure_motions(course, standard, scope, Store(tmp_path / "points.jsonl", MotionPoint), quiet)
    assert [(p.method, p.finding) for p in points] == [("rk4", "")]
    assert points[0].error is not None
    assert points[0].error < 1e-5


def test_time_stepping_stands_beside_the_way_from_event_to_event(tmp_path: Path) -> None:
    """A pendulum that hits a stop: errors fall with the step, or with the tolerance, which gives more digits."""
    file = tmp_path / "stopped.yaml"
    file.write_text(
        PENDULUM.replace("axis: y", "axis: y, limits: [-0.5, 2], stops: {restitution: 0.5}"), encoding="utf-8"
    )
    course = Course(Mechanism(find_folder(file, EXTENT)), np.array([1.0]), np.zeros(1), hold([]), 1.3, "stopped")
    standard = motions.find_standard(course)
    assert standard.accuracy < 1e-10
    scope = MotionScope(divisions=(1, 4), shorter=(4, 256), tolerances=(1e-4, 1e-9), rounds=1)
    points = motions.measure_motions(course, standard, scope, Store(tmp_path / "store.jsonl", MotionPoint), quiet)
    found = [(p.method, p.error) for p in points if p.error is not None]
    errors = {method: [error for own, error in found if own == method] for method in ("moreau", "dop853")}
    assert errors["moreau"][1] < errors["moreau"][0] / 10
    assert errors["dop853"][1] < 1e-7
    assert {p.method for p in points} == {"euler", "rk4", "rk45", "dop853", "moreau"}
