"""Slips of tyres that are states: closed forms, SciPy, methods, derivatives, optimal control."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from mbsgen.expressions import parse
from mbsgen.model.file.tir import read_tyre
from mbsgen.model.tyres import MAGIC
from mbsrun import Mechanism, load, read_problem
from mbsrun.models import Extent
from mbsrun.simulation import Motion, Settings, differentiate, simulate
from mbsrun.simulation.course import follow
from mbsrun.simulation.drive import hold
from mbsrun.simulation.formulation import Formulation
from tests.mbsgen.model.printed import RADIUS, ROAD, print_formulas

Array = NDArray[np.float64]

RIG = """
name: rig
gravity: [0, 0, 0]
bodies:
  - name: hub
    joint:
      - {name: x, type: prismatic, axis: x, actuated: false}
      - {name: y, type: prismatic, axis: y, actuated: false}
      - {name: z, type: prismatic, axis: z, actuated: false}
      - {name: spin, type: revolute, axis: y, actuated: false}
    mass: 20
    inertia: [0.7, 1.2, 0.7]
contacts:
  - {name: road, body: hub, wheel: {radius: 0.313}, stiffness: 2.1e5, exponent: 1, tyre: {TYRE}}
driven: [x, y, z]
"""
BRUSH = "brush: {longitudinal: 8e4, lateral: 6e4, friction: 0.9, relaxation: {longitudinal: 0.3, lateral: 0.6}}"
NEEDED = Extent(("exp2", "impl", "semi", "semi_res", "energy", "power", "frames", "reactions"), 1)
LENGTHS = "PTX1 = 1.9\nPTX2 = 0.3\nPTX3 = 0.4\nPTY1 = 2.1\nPTY2 = 1.6\n"
FILE = "file: road.tir, transient: true, coefficients: {LSGKP: 0.9, LSGAL: 1.2}"


def make(folder: Path, tyre: str, text: str = RIG) -> Mechanism:
    (folder / "road.tir").write_text(ROAD.read_text() + LENGTHS)
    (folder / "rig.yaml").write_text(text.replace("TYRE", tyre))
    return load(folder / "rig.yaml", extent=NEEDED)


def drive(model: Mechanism, motions: list[str], qd: list[float], end: float, **settings: object) -> Motion:
    """Simulate the rig on given motions of its centre."""
    course = follow([parse(x) for x in motions], ["x", "y", "z"], {})
    q, tight = [0, 0, 0.293, 0, 0, 0], {"rtol": 1e-12, "atol": 1e-12}
    return simulate(model, hold([]), q, qd, Settings(end, **{**tight, **settings}), course=course)  # type: ignore[arg-type]


def test_the_lateral_force_of_a_brush_lags_by_its_length(tmp_path: Path) -> None:
    """A step of the slip angle: v = sigma tan(alpha) (1 - exp(-V t/sigma)), and the force of a brush."""
    V, slip, load, C = 20.0, 0.03, 2.1e5 * 0.02, 6e4
    motion = drive(make(tmp_path, BRUSH), ["20*t", "0.6*t", "0.293"], [V, 0.6, 0, V / RADIUS, 0, 0], 0.1)
    assert np.abs(motion["qd_spin"] - V / RADIUS).max() < 1e-9  # no slip forward
    assert np.abs(motion["qd_road_longitudinal"]).max() < 1e-12
    v = 0.6 * slip * (1 - np.exp(-V * motion.t / 0.6))
    np.testing.assert_allclose(motion["qd_road_lateral"], v, rtol=1e-9, atol=1e-12)
    elastic = C * v / 0.6
    m = 1 - elastic / (3 * 0.9 * load)
    force = elastic * (1 + m + m**2) / 3  # sum of bristles that stick and slide
    np.testing.assert_allclose(motion["tau_y"], force, rtol=1e-8, atol=1e-3)


def test_the_magic_formula_relaxes_as_scipy_integrates_it(tmp_path: Path) -> None:
    """The printed formulas at the slips u/sigma and v/sigma, under a load, a speed and a side slip that vary."""
    motions = ["20*t - 0.3*t**2", "0.1*(1 - cos(9*t))", "0.313 - 0.02 - 0.006*sin(12*t)"]
    motion = drive(make(tmp_path, FILE), motions, [20.0, 0, -0.072, 66.0, 0, 0], 0.8)
    c = {key: 0.0 if value is None else value for key, value in MAGIC.items()}
    c |= {**read_tyre(tmp_path / "road.tir").magic, "LSGKP": 0.9, "LSGAL": 1.2}
    at = c["FNOMIN"] / 2.1e5

    def find(t: float, x: Array) -> tuple[list[float], Array]:
        spin, u, v = x
        V, side, depth = 20 - 0.6 * t, 0.9 * np.sin(9 * t), 0.02 + 0.006 * np.sin(12 * t)
        load = 2.1e5 * depth
        dfz = load / c["FNOMIN"] - 1
        sx = load * (c["PTX1"] + c["PTX2"] * dfz) * np.exp(-c["PTX3"] * dfz) * RADIUS / c["FNOMIN"] * c["LSGKP"]
        sy = c["PTY1"] * np.sin(2 * np.arctan(load / (c["PTY2"] * c["FNOMIN"]))) * RADIUS * c["LSGAL"]
        rolling = RADIUS - at * (c["DREFF"] * np.arctan(c["BREFF"] * depth / at) + c["FREFF"] * depth / at)
        Fx, _, _, My, _ = forces = print_formulas(c, load, u / sx, np.arctan(v / sy), 0.0, V)
        rates = [((depth - RADIUS) * Fx + My) / 1.2, rolling * spin - V - V * u / sx, side - V * v / sy]
        return rates, forces

    found = solve_ivp(lambda t, x: find(t, x)[0], (0, 0.8), [66.0, 0, 0], "DOP853", rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(motion.qd[-1, 3:], found.y[:, -1], rtol=1e-7)
    Fx, Fy, *_ = find(0.8, found.y[:, -1])[1]
    side = 20 * 0.1 * 81 * np.cos(9 * 0.8)
    np.testing.assert_allclose(motion["tau_y"][-1], side - Fy, rtol=1e-7)
    np.testing.assert_allclose(motion["tau_x"][-1], -20 * 0.6 - Fx, rtol=1e-7)


FREE = RIG.replace("driven: [x, y, z]\n", "").replace("gravity: [0, 0, 0]", "gravity: [0, 0, -200]")
START = [20.0, 0.5, 0.0, 70.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("method", "step", "bound"),
    [
        ("rk4", 2e-4, 1e-9),
        ("radau", None, 1e-9),
        ("gauss", 2e-4, 1e-9),
        ("generalized-alpha", 2e-4, 4e-7),
        ("variational", 2e-4, 4e-7),
        ("moreau", 2e-4, 4e-7),
    ],
)
def test_all_methods_have_the_states(tmp_path: Path, method: str, step: float | None, bound: float) -> None:
    """A wheel that falls, and slips forward and across: errors of its deflections by the orders of methods."""
    model, q = make(tmp_path, FILE, FREE), [0, 0, 0.293, 0, 0, 0]
    best = simulate(model, hold([]), q, START, Settings(0.03, rtol=1e-12, atol=1e-12))
    formulation = Formulation.IMPL if method == "variational" else Formulation.EXP2
    settings = Settings(0.03, method, formulation, rtol=1e-9, atol=1e-9)
    found = simulate(model, hold([]), q, START, settings if step is None else replace(settings, step=step))
    assert found.is_complete
    assert np.abs(best.qd[-1, 4:]).min() > 4e-3
    assert np.abs(found.qd[-1, 4:] - best.qd[-1, 4:]).max() < bound


def test_they_are_differentiated(tmp_path: Path) -> None:
    """The derivative of the end by the start, deflections included, equals central differences."""
    model, q = make(tmp_path, BRUSH, FREE), np.array([0, 0, 0.293, 0, 0, 0])
    start, settings = np.array([20.0, 0.5, 0.0, 70.0, 2e-3, 1e-3]), Settings(0.05, rtol=1e-12, atol=1e-12)
    found = differentiate(model, hold([]), q, start, settings)
    for k in (1, 4, 5):
        h = 1e-6
        ends = [simulate(model, hold([]), q, start + sign * h * np.eye(6)[k], settings).qd[-1] for sign in (1, -1)]
        np.testing.assert_allclose(found.slopes[6:, 6 + k], (ends[0] - ends[1]) / (2 * h), rtol=1e-5, atol=1e-5)


PROBLEM = """
model: rig.yaml
horizon: 1
intervals: 40
scheme: radau
degree: 3
start: {pose: {}, velocity: {x: 20, spin: 20/0.313}}
end: {pose: {y: 0.5}, velocity: {y: 0}}
guess: {motion: line, end: {x: 20, spin: 20/0.313}}
cost: {inputs: 1e-3}
"""
CART = RIG.replace(
    "axis: y, actuated: false}\n      - {name: z, type: prismatic, axis: z, actuated: false}", "axis: y}"
)
CART = CART.replace("mass: 20", "mass: 300").replace("[0.7, 1.2, 0.7]", "[20, 20, 20]")
CART = CART.replace("driven: [x, y, z]\n", "").replace("tyre:", "plane: {position: [0, 0, -0.293]}, tyre:")


def test_optimal_control_has_the_states(tmp_path: Path) -> None:
    """A wheel is pushed across in least effort; SciPy integrates the equations of a brush under the inputs found."""
    make(tmp_path, BRUSH, CART)
    (tmp_path / "push.ocp.yaml").write_text(PROBLEM)
    solved = read_problem(tmp_path / "push.ocp.yaml").solve()
    found = solved.solution.trajectory
    C, load, lengths, R = np.array([8e4, 6e4]), 2.1e5 * 0.02, np.array([0.3, 0.6]), RADIUS

    def rate(_: float, x: Array, push: float) -> Array:
        _, vx, vy, spin, *bent = x
        e = C * [1, -1] * bent / lengths
        p = float(np.hypot(*e)) / (3 * 0.9 * load)
        m = max(1 - p, 0.0)
        Fx, Fy = (1 + m + m**2) / (3 * max(p, 1)) * e
        lags = np.array([R * spin - vx, vy]) - R * spin * np.array(bent) / lengths
        return np.array([vy, Fx / 300, (push + Fy) / 300, -0.293 * Fx / 20, *lags])

    x = np.array([0, 20, 0, 20 / R, 0, 0])
    for begin, end, (push,) in zip(found.t, found.t[1:], found.u, strict=False):
        x = solve_ivp(rate, (begin, end), x, "DOP853", rtol=1e-11, atol=1e-12, args=(push,)).y[:, -1]
    np.testing.assert_allclose(x, [found.q[-1, 1], *found.qd[-1]], atol=1e-5)
    assert x[0] == pytest.approx(0.5, abs=1e-5)
    assert np.abs(found.qd[:, 4]).max() > 5e-3
