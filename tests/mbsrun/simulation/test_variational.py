"""Variational steps on groups: the heavy top of Bruls and Cardona against its closed form, forces, momenta, loops.

The top (Journal of Computational and Nonlinear Dynamics 5 (2010), 031002, section 6): 15 kg, its centre of mass 1 m
along y from the tip, 0.234375, 0.46875, 0.234375 kg m^2 about it; it starts level, at w1 = 150 rad/s about y and
w2 = -4.61538 rad/s about z. With J1 = 15.234375 about the tip and u the height of the centre of mass, energy and both
momenta give

    u'^2 = (1 - u^2) (w2^2 - b u) - (w2 - a u)^2,    a = J3 w1 / J1,    b = 2 m g / J1

so u = u1 + (u2 - u1) cd(sqrt(b (u3 - u1)) t / 2)^2 with the roots u1 < u2 = 0 < u3 (Whittaker, "Analytical Dynamics",
section 71).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import ellipj

from mbsgen.expressions import parse
from mbsrun import Mechanism
from mbsrun.models import Extent, find_folder
from mbsrun.simulation import Motion, Settings, control, simulate
from mbsrun.simulation.drive import express, hold
from mbsrun.simulation.integration import implicit, rattle
from mbsrun.simulation.integration.groups import find_group

TOP = """
name: NAME
gravity: [0, 0, -9.81]
bodies:
  - name: top
    joint: {type: JOINT, actuated: ACTUATED}
    mass: 15
    com: [0, 1, 0]
    inertia: [0.234375, 0.46875, 0.234375]
"""
PIN = "loops:\n  - {name: tip, type: ball, from: {body: base}, to: {body: top}}\n"
SPIN, TURN = 150.0, -4.61538
OWN = ("impl", "exp2", "energy", "power", "frames", "rates")
LOOPS = ("loops", "loop_rates", "loop_jacobian")


def make(folder: Path, joint: str, *functions: str, more: str = "", actuated: str = "false") -> Mechanism:
    file = folder / "top.yaml"
    text = TOP.replace("NAME", f"top_{joint}").replace("JOINT", joint).replace("ACTUATED", actuated)
    file.write_text(text + more, encoding="utf-8")
    return Mechanism(find_folder(file, Extent((*OWN, *functions), 1)))


@pytest.fixture(scope="module")
def top(tmp_path_factory: pytest.TempPathFactory) -> Mechanism:
    return make(tmp_path_factory.mktemp("ball"), "ball", actuated="true")


@pytest.fixture(scope="module")
def pinned(tmp_path_factory: pytest.TempPathFactory) -> Mechanism:
    """Pin a free body by a loop: six velocities, three equations."""
    return make(tmp_path_factory.mktemp("free"), "free", *LOOPS, more=PIN)


def height(t: np.ndarray) -> np.ndarray:
    """Return the height of the centre of mass in m, in closed form."""
    axial, lateral = 0.46875, 15.234375
    fall, ratio = 2 * 15 * 9.81 / lateral, axial * SPIN / lateral
    cubic = np.poly1d([-1, 0, 1]) * np.poly1d([-fall, TURN**2]) - np.poly1d([-ratio, TURN]) ** 2
    low, middle, high = np.sort(cubic.roots.real)
    _, cn, dn, _ = ellipj(np.sqrt(fall * (high - low)) / 2 * t, (middle - low) / (high - low))
    return np.asarray(low + (middle - low) * (cn / dn) ** 2)


def spin(kernels: Mechanism, duration: float, method: str = "variational", **settings: Any) -> Motion:
    q = [0.0] * (len(kernels.manifest.positions) - 1) + [1.0]
    qd = [0.0] * (len(kernels.manifest.coordinates) - 3) + [0.0, SPIN, TURN]
    drive = hold(np.zeros(len(kernels.manifest.inputs)))
    motion = simulate(kernels, drive, q, qd, Settings(duration, method, **settings))
    assert motion.is_complete, motion.halt
    return motion


def rise(motion: Motion) -> np.ndarray:
    """Return the height: the third entry of the turned y axis."""
    x, y, z, w = motion.q[:, -4:].T
    return np.asarray(2 * (y * z + w * x))


def test_the_closed_form_is_the_top_s(top: Mechanism) -> None:
    motion = spin(top, 0.5, "dop853", rtol=1e-13, atol=1e-13)
    assert np.abs(rise(motion) - height(motion.t)).max() < 1e-9
    assert rise(motion).min() < -0.5


@pytest.mark.parametrize(("method", "error"), [("variational", 1e-3), ("generalized-alpha", 1e-2)])
def test_steps_on_groups_have_order_2(top: Mechanism, method: str, error: float) -> None:
    """A quarter of the error by half of the step, along the whole way; quaternions have length 1 to one rounding."""
    errors = []
    for step in (1e-3, 5e-4):
        motion = spin(top, 0.2, method, step=step, rho=1.0)
        errors.append(np.abs(rise(motion) - height(motion.t)).max())
        assert np.abs(np.linalg.norm(motion.q, axis=1) - 1).max() <= 4 * np.finfo(float).eps
    assert errors[1] < error
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.1)


@pytest.mark.parametrize("method", ["variational", "generalized-alpha"])
def test_a_pinned_free_body_is_the_ball(top: Mechanism, pinned: Mechanism, method: str) -> None:
    """With a loop at the tip, steps are the ones of the ball, to rounding; the loop and its rate stay closed."""
    first, other = (spin(x, 0.02, method, step=1e-3, rho=1.0) for x in (top, pinned))
    assert other.closure is not None
    assert np.abs(first.q - other.q[:, 3:]).max() < 1e-10
    assert np.abs(first.qd - other.qd[:, 3:]).max() < 1e-8
    assert other.closure.position.max() < 1e-13
    assert other.closure.velocity.max() < (1e-11 if method == "variational" else 1e-3)


def test_energy_does_not_drift_in_a_million_steps(top: Mechanism) -> None:
    """Energy swings with the fall, by O(h^2), and comes back; the moment about z and the spin about y stay.

    A million roundings of some 1e-14 of a moment of 70 add up to 1e-9 at most. The classical Runge-Kutta method loses
    28 J with the same steps.
    """
    motion = spin(top, 1000.0, step=1e-3, output_step=0.05)
    assert motion.effort.steps == 1_000_000
    assert motion.energy is not None
    parts = np.array_split(motion.energy.drift, 10)
    assert np.abs(parts[0]).max() == pytest.approx(0.2586, abs=1e-3), "of 5,400 J, with a fall of 147 J"
    assert np.ptp([np.abs(x).max() for x in parts]) < 1e-4
    assert np.ptp([x.mean() for x in parts]) < 2e-4
    vertical = top("energy", q=motion.q, qd=motion.qd)["angular_momentum"][:, 2]
    assert np.abs(vertical - vertical[0]).max() < 1e-9
    assert np.abs(motion.qd[:, 1] - SPIN).max() < 1e-8
    assert np.abs(np.linalg.norm(motion.q, axis=1) - 1).max() <= 4 * np.finfo(float).eps


def _refuse(*_: object) -> None:
    """Stand in for steps in Python, which repeat the first step that fails in C."""
    pytest.fail("a step in C failed")


@pytest.mark.parametrize("name", ["top", "pinned"])
def test_steps_in_c_are_the_ones_in_python(
    name: str, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With moments over time, or a loop: the same results, to the rounding of both."""
    kernels = request.getfixturevalue(name)
    texts = ["20*sin(9*t)", "3", "-t"] if name == "top" else []
    q = [0.0] * (len(kernels.manifest.positions) - 1) + [1.0]
    qd = [0.0] * (len(kernels.manifest.coordinates) - 3) + [0.0, SPIN, TURN]
    motions = []
    for is_taken in (True, False):
        if is_taken:
            monkeypatch.setattr(implicit, "integrate", _refuse)
        else:
            monkeypatch.undo()
            monkeypatch.setattr(rattle, "is_taken", lambda *_: False)
        settings = Settings(0.02, "variational", step=1e-3, output_step=1e-3)
        motions.append(simulate(kernels, express([parse(x) for x in texts], texts, {}), q, qd, settings))
    first, other = motions
    assert first.is_complete
    assert other.is_complete
    assert np.abs(first.q - other.q).max() < 1e-11
    assert np.abs(first.qd - other.qd).max() < 1e-9
    assert first.effort.iterations == other.effort.iterations, "of Newton's method, with the same slopes"
    assert first.energy is not None
    assert other.energy is not None
    assert np.abs(first.energy.drift - other.energy.drift).max() < 1e-8
    assert np.ptp(first.qd[:, -3]) > 1e-2


@pytest.mark.parametrize("name", ["top", "pinned"])
def test_slow_steps_in_c_are_the_ones_in_python(
    name: str, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Below an angle of 1e-3 in a step, functions of the angle are at their limits, such as 1/12 of its square.

    Half of it changes velocities by 1e-8 of their size, a thousand times the rounding of Newton's method.
    """
    kernels = request.getfixturevalue(name)
    q = [0.0] * (len(kernels.manifest.positions) - 1) + [1.0]
    qd = [0.0] * (len(kernels.manifest.coordinates) - 3) + [0.1, 0.4, -0.3]
    motions = []
    for is_taken in (True, False):
        if is_taken:
            monkeypatch.setattr(implicit, "integrate", _refuse)
        else:
            monkeypatch.undo()
            monkeypatch.setattr(rattle, "is_taken", lambda *_: False)
        settings = Settings(0.02, "variational", step=1e-3, output_step=1e-3)
        motions.append(simulate(kernels, hold(np.zeros(len(kernels.manifest.inputs))), q, qd, settings))
    first, other = motions
    assert first.is_complete
    assert other.is_complete
    assert np.abs(first.q - other.q).max() < 1e-12
    assert np.abs(first.qd - other.qd).max() < 1e-11


def test_moments_act_with_order_2(top: Mechanism) -> None:
    """A moment over time, and a law of the velocities: a quarter of the error, and the work is accounted for."""

    def brake(t: float, _: np.ndarray, qd: np.ndarray) -> np.ndarray:
        return np.array([20 * np.sin(9 * t), -0.05 * qd[1], 0]) - 0.3 * qd

    found = []
    for method, step in (("dop853", 1e-3), ("variational", 2e-3), ("variational", 1e-3)):
        settings = Settings(0.1, method, step=step, rtol=1e-12, atol=1e-12)
        motion = simulate(top, control(brake), [0, 0, 0, 1], [0, SPIN, TURN], settings)
        assert motion.is_complete
        found.append(np.concatenate((motion.q[-1], motion.qd[-1])))
        assert motion.energy is not None
        assert np.abs(motion.energy.drift).max() < 1e-3 * np.abs(motion.energy.work).max()
    errors = [np.abs(x - found[0]).max() for x in found[1:]]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.1)


@pytest.mark.parametrize("size", [1.0, 1e-2, 1e-4])
def test_derivatives_of_the_group_are_differences(pinned: Mechanism, size: float) -> None:
    """tau(-x) is the inverse; A(-x)^-1 is the way of the end, by the kernel of the rates; so is d A(x)^T p."""
    group, rng, e = find_group(pinned), np.random.default_rng(1), 1e-6
    x, p, q = size * rng.normal(size=6), rng.normal(size=6), rng.normal(size=7)
    q[3:] /= np.linalg.norm(q[3:])
    end = group.move(q, x)
    assert np.abs(group.move(end, -x) - q).max() < 1e-15
    ways = np.array([(group.move(q, x + d) - group.move(q, x - d)) / (2 * e) for d in e * np.eye(6)]).T
    along = pinned("jac_rates", q=end, qd=np.zeros(6))["jac_rate_qd"]
    assert np.abs(along @ group.carry(x) - ways).max() < 1e-9
    slopes = [(group.trivialise(x + d).T - group.trivialise(x - d).T) @ p / (2 * e) for d in e * np.eye(6)]
    assert np.abs(group.vary(x, p) - np.array(slopes).T).max() < 1e-9
