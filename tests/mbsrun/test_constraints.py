"""Constraints by expressions, with and without a driven joint, against a tree and their closed form.

A cam, a product of coordinates and a sum with coefficients at run time leave three of six coordinates, y: q = f(y).
With Z = df/dy, the equations of motion are Z^T (M (Z y'' + Z' y') + c - Q) = 0, with M, c and Q of the tree without the
constraints. So each command is compared with a few lines of NumPy, which know no loops.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from click.testing import CliRunner
from fmpy.validation import validate_fmu
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from mbsgen.expressions import parse
from mbsrun import Mechanism, cli, load
from mbsrun.linearisation import BalanceError, find_pose, linearise, settle
from mbsrun.models import INTEGRATED, Extent
from mbsrun.simulation import Formulation, Keeping, Settings, follow, simulate
from mbsrun.simulation.closing import Start, close_start
from mbsrun.simulation.course import stand
from mbsrun.simulation.drive import hold
from mbsrun.simulation.inverse import invert

Array = NDArray[np.float64]

TREE = """\
gravity: [0.4, -0.3, -3]
parameters: {l: {value: 0.15, kind: runtime}, a: {value: 0.7, kind: runtime}, b: {value: -0.4, kind: runtime}}
bodies:
  - {name: table, joint: {name: q1, type: revolute, axis: z, damping: 0.1}, mass: 2, com: [0.1, 0.02, 0],
     inertia: [0.02, 0.03, 0.04]}
  - {name: arm, parent: table, joint: {name: q2, type: revolute, axis: y, position: [0.3, 0, 0], stiffness: 4}, mass: 1,
     com: [0.2, 0, 0.05], inertia: [0.02, 0.03, 0.04]}
  - {name: slider, joint: {name: q3, type: prismatic, axis: [0.6, 0, 0.8], actuated: false, stiffness: 20}, mass: 0.6}
  - {name: wheel, parent: arm, joint: {name: q4, type: revolute, axis: x, position: [0.4, 0, 0], actuated: false},
     mass: 0.5, com: [0, 0.05, 0.02], inertia: [0.01, 0.01, 0.01]}
  - {name: pin, parent: slider, joint: {name: q5, type: revolute, axis: y, actuated: false, damping: 0.02}, mass: 0.7,
     com: [0.1, 0.05, -0.1], inertia: [0.01, 0.02, 0.01]}
  - {name: bob, parent: pin, joint: {name: q6, type: revolute, axis: x, position: [0, 0, -0.2], actuated: false,
     damping: 0.03}, mass: 0.4, com: [0, 0.02, -0.15], inertia: [0.005, 0.005, 0.002]}
forces:
  - {name: spring, from: {body: base, position: [0.3, 0.4, 0.9]}, to: {body: bob, position: [0.1, 0.1, 0.3]},
     stiffness: 15, rest: 0.2, damping: 0.3}
"""
CONSTRAINTS = """\
constraints:
  - {name: cam, equation: q3 - l*sin(q1)**2 - 0.05}
  - {name: product, equation: q4*(1 + q2**2) - 0.5*q1}
  - {name: sum, equation: q5 - a*q1 - b*q2 - 0.1}
independent: [q1, q2, q6]
"""
LIFT, A, B = 0.15, 0.7, -0.4
INPUTS = np.array([0.3, -0.2])
START = np.array([0.4, -0.3, 0.2]), np.array([0.6, 0.7, -0.4])
COURSE = "0.4 + 0.3*sin(2*t)"  # of q1, as at the start
TIME = 0.4
VALUES = ("semi", "semi_res", "exp2", "energy", "power", "frames")
LOOPS = ("loops", "loop_rates", "loop_jacobian")


def place(y: Array) -> Array:
    """Return q = f(y), y = (q1, q2, q6)."""
    q1, q2, q6 = y
    return np.array([q1, q2, LIFT * np.sin(q1) ** 2 + 0.05, 0.5 * q1 / (1 + q2**2), A * q1 + B * q2 + 0.1, q6])


def slope(y: Array) -> Array:
    """Return Z = df/dy."""
    q1, q2, _ = y
    d = 1 + q2**2
    wheel = [0.5 / d, -q1 * q2 / d**2, 0]
    return np.array([[1, 0, 0], [0, 1, 0], [LIFT * np.sin(2 * q1), 0, 0], wheel, [A, B, 0], [0, 0, 1]])


def bend(y: Array, yd: Array) -> Array:
    """Return Z' y', the accelerations of q where y has none."""
    (q1, q2, _), (v1, v2, _) = y, yd
    d = 1 + q2**2
    cam = 2 * LIFT * np.cos(2 * q1) * v1**2
    wheel = -2 * q2 * v1 * v2 / d**2 + q1 * v2**2 * (4 * q2**2 / d**3 - 1 / d**2)
    return np.array([0, 0, cam, wheel, 0, 0])


def course(t: float) -> tuple[float, float, float]:
    """Return the motion of q1."""
    return 0.4 + 0.3 * np.sin(2 * t), 0.6 * np.cos(2 * t), -1.2 * np.sin(2 * t)


@dataclass(frozen=True, eq=False)
class Case:
    """The model with the constraints; driven: q1 moves by `course`, and has no input."""

    tree: Mechanism
    model: Path
    driven: bool

    @cached_property
    def kernels(self) -> Mechanism:
        extent = Extent((*VALUES, "impl", *LOOPS), 1, values=VALUES)
        return load(self.model, extent=extent)

    @property
    def inputs(self) -> Array:
        return INPUTS[1:] if self.driven else INPUTS

    def reduce(self, y: Array, yd: Array) -> tuple[Array, Array]:
        """Return M and c of M y'' + c = tau, under the inputs; tau is the force of the driven joint."""
        q, qd, Z = place(y), slope(y) @ yd, slope(y)
        u = INPUTS if not self.driven else np.array([0, INPUTS[1]])
        c = self.tree.semi_res(q=q, qd=qd, u=u, qdd=bend(y, yd))["Phi"]
        return Z.T @ self.tree.semi(q=q, qd=qd)["M"] @ Z, Z.T @ c

    def accelerate(self, y: Array, yd: Array, given: float) -> tuple[Array, float]:
        """Return y'' and the force of the driven joint, whose acceleration is given."""
        M, c = self.reduce(y, yd)
        if not self.driven:
            return np.linalg.solve(M, -c), 0.0
        ydd = np.concatenate(([given], np.linalg.solve(M[1:, 1:], -c[1:] - M[1:, 0] * given)))
        return ydd, float(M[0] @ ydd + c[0])

    @cached_property
    def end(self) -> tuple[Array, Array, float]:
        """Integrate y; return y, y' and the force of the driven joint at the end."""

        def put(t: float, state: Array) -> tuple[Array, Array]:
            y, yd = state[:3].copy(), state[3:].copy()
            if self.driven:
                y[0], yd[0], _ = course(t)
            return y, yd

        def rates(t: float, state: Array) -> Array:
            y, yd = put(t, state)
            return np.concatenate((yd, self.accelerate(y, yd, course(t)[2])[0]))

        whole = solve_ivp(rates, (0, TIME), np.concatenate(START), "DOP853", rtol=1e-11, atol=1e-11).y[:, -1]
        y, yd = put(TIME, whole)
        return y, yd, self.accelerate(y, yd, course(TIME)[2])[1]


@pytest.fixture(scope="module", params=[False, True], ids=["free", "driven"])
def case(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Case:
    folder = tmp_path_factory.mktemp("constraints")
    (folder / "tree.yaml").write_text(f"name: tree\n{TREE}", encoding="utf-8")
    text, name = TREE + CONSTRAINTS, "free"
    if request.param:
        text, name = text.replace("axis: z,", "axis: z, actuated: false,") + "driven: [q1]\n", "driven"
    (folder / f"{name}.yaml").write_text(f"name: {name}\n{text}", encoding="utf-8")
    tree = load(folder / "tree.yaml", extent=Extent(("semi", "semi_res"), 0))
    return Case(tree, folder / f"{name}.yaml", request.param)


def differentiate(f: Callable[[Array], Array], x: Array, h: float = 1e-4) -> Array:
    """Differentiate by differences of order 4."""
    steps = h * np.eye(len(x))
    return np.array([(8 * (f(x + s) - f(x - s)) - f(x + 2 * s) + f(x - 2 * s)) / (12 * h) for s in steps]).T


WAYS: dict[str, tuple[dict[str, Any], float]] = {
    "projection": ({}, 1e-8),
    "partitioning": ({"loops": Keeping.PARTITIONING, "formulation": Formulation.SEMI}, 1e-8),
    "mass-projection": ({"loops": Keeping.MASS_PROJECTION, "formulation": Formulation.SEMI}, 1e-8),
    "baumgarte": ({"loops": Keeping.BAUMGARTE, "method": "rk45"}, 1e-7),
    "radau-iia": ({"method": "radau-iia", "step": 5e-3, "stages": 3}, 1e-7),
    "variational": ({"method": "variational", "step": 1e-3}, 1e-3),
    "generalized-alpha": ({"method": "generalized-alpha", "step": 1e-3}, 1e-3),
}


@pytest.mark.parametrize("way", WAYS)
def test_motions_are_the_ones_of_the_closed_form(requires: Callable[[str], str], case: Case, way: str) -> None:
    requires("cc")
    y, yd = START
    options, most = WAYS[way]
    if "method" in options and "loops" not in options:
        options = {**options, "formulation": Formulation.IMPL}
    motion = simulate(
        case.kernels,
        hold(case.inputs),
        place(y),
        slope(y) @ yd,
        Settings(TIME, rtol=1e-10, atol=1e-10, output_step=0.1, **options),
        course=follow([parse(COURSE)], ["q1"], {}) if case.driven else stand(()),
    )
    assert motion.is_complete, motion.halt
    y, yd, tau = case.end
    assert motion.q[-1] == pytest.approx(place(y), abs=most)
    assert motion.qd[-1] == pytest.approx(slope(y) @ yd, abs=10 * most)
    assert motion.closure is not None
    if case.driven:
        assert motion.closure.driving[-1, 0] == pytest.approx(tau, abs=10 * most)


def test_joints_that_nothing_moves_stay(requires: Callable[[str], str], case: Case) -> None:
    """Of three freedoms one is given: the others keep their places, and are at rest."""
    requires("cc")
    base = place(np.array([0.1, -0.2, 0.3]))
    q, qd = base.copy(), np.zeros(6)
    q[0], qd[0] = course(0.0)[:2]
    given = frozenset(() if case.driven else (0,))
    along = follow([parse(COURSE)], ["q1"], {}) if case.driven else stand(())
    pose, velocities, note = close_start(case.kernels, Start(base, q, qd, given, given), along)
    y = np.array([q[0], -0.2, 0.3])
    assert pose == pytest.approx(place(y), abs=1e-12)
    assert velocities == pytest.approx(slope(y) @ [qd[0], 0, 0], abs=1e-12)
    assert not note


def test_small_motions_are_differences_of_the_closed_form(requires: Callable[[str], str], case: Case) -> None:
    """Driven joints stand still, and their force is the one that this takes."""
    requires("cc")
    pose = find_pose(case.kernels, {"q1": 0.4, "q2": -0.3})
    found = linearise(case.kernels, settle(case.kernels, pose, case.inputs))
    at = found.equilibrium
    y, first = at.q[[0, 1, 5]], 1 if case.driven else 0
    size = 3 - first
    assert found.freedoms == ("q1", "q2", "q6")[first:]
    assert at.q == pytest.approx(place(y), abs=1e-12)

    def rates(state: Array) -> Array:
        moved, moving = y.copy(), np.zeros(3)
        moved[first:], moving[first:] = state[:size], state[size:]
        return np.concatenate((moving[first:], case.accelerate(moved, moving, 0.0)[0][first:]))

    rest = np.concatenate((y[first:], np.zeros(size)))
    assert rates(rest) == pytest.approx(np.zeros(2 * size), abs=1e-8)
    assert np.abs(found.A - differentiate(rates, rest)).max() < 1e-6
    M, c = case.reduce(y, np.zeros(3))
    inputs = slope(y)[:2].T[first:, first:]
    assert found.B[size:] == pytest.approx(np.linalg.solve(M[first:, first:], inputs), abs=1e-9)
    if case.driven:
        assert at.q[0] == 0.4
        assert at.tau == pytest.approx([c[0]], abs=1e-9)


def test_forces_of_a_motion_are_the_ones_of_the_closed_form(requires: Callable[[str], str], case: Case) -> None:
    requires("cc")
    given = follow([parse(COURSE), parse("0.2*t**2"), parse("0.1*t")], ["q1", "q2", "q6"], {})
    found = invert(case.kernels, [0, 1, 5], given, np.linspace(0, 1, 5))
    for k, t in enumerate(found.t):
        q1, qd1, qdd1 = course(t)
        y, yd, ydd = np.array([q1, 0.2 * t**2, 0.1 * t]), np.array([qd1, 0.4 * t, 0.1]), np.array([qdd1, 0.4, 0])
        q, qd, Z = place(y), slope(y) @ yd, slope(y)
        forces = Z.T @ case.tree.semi_res(q=q, qd=qd, u=np.zeros(2), qdd=Z @ ydd + bend(y, yd))["Phi"]
        assert found.q[k] == pytest.approx(q, abs=1e-12)
        assert np.concatenate((found.tau[k], found.u[k])) == pytest.approx(forces[:2], abs=1e-9)
        assert found.rest[k] == pytest.approx([0, 0, 0, 0, 0, forces[2]], abs=1e-9)


def test_equations_to_read_hold_constraints_and_forces_of_driven_joints(
    requires: Callable[[str], str], case: Case, rng: np.random.Generator
) -> None:
    """The residual of the tree, less J^T lam of the closed form, and tau."""
    requires("cc")
    found = case.kernels.symbolic()
    q, qd, qdd = rng.uniform(-0.5, 0.5, (3, 6))
    lam, tau = rng.normal(size=3), rng.normal(size=1)
    given = {"q": q, "qd": qd, "qdd": qdd, "u": case.inputs, "lam": lam} | ({"tau": tau} if case.driven else {})
    h = [q[2] - LIFT * np.sin(q[0]) ** 2 - 0.05, q[3] * (1 + q[1] ** 2) - 0.5 * q[0], q[4] - A * q[0] - B * q[1] - 0.1]
    J = np.zeros((3, 6))
    J[0, [0, 2]] = -LIFT * np.sin(2 * q[0]), 1
    J[1, [0, 1, 3]] = -0.5, 2 * q[1] * q[3], 1 + q[1] ** 2
    J[2, [0, 1, 4]] = -A, -B, 1
    assert found.evaluate(found.h, q=q)[:, 0] == pytest.approx(h, abs=1e-14)
    assert found.evaluate(found.J, q=q) == pytest.approx(J, abs=1e-14)
    inputs = np.concatenate((tau, case.inputs)) if case.driven else case.inputs
    expected = case.tree.semi_res(q=q, qd=qd, qdd=qdd, u=inputs)["Phi"] - J.T @ lam
    assert found.evaluate(found.residual, **given)[:, 0] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_units_move_as_the_closed_form(requires: Callable[[str], str], case: Case, tmp_path: Path, fmi: str) -> None:
    """In co-simulation, where the driven joint goes on with its acceleration, and others start where they must."""
    requires("cc")
    unit = tmp_path / "unit.fmu"
    assert CliRunner().invoke(cli.cli, ["fmu", str(case.model), "--fmi", fmi, "-o", str(unit)]).exit_code == 0
    assert validate_fmu(str(unit)) == []
    (q1, q2, q6), (v1, v2, v6) = START
    given = {"q_q1": q1, "q_q2": q2, "q_q6": q6, "qd_q1": v1, "qd_q2": v2, "qd_q6": v6, "u_q2": INPUTS[1]}
    given |= {"qdd_q1": 1.0} if case.driven else {"u_q1": INPUTS[0]}
    names = [f"q_q{k}" for k in range(1, 7)]
    ends: dict[str, Any] = {"stop_time": 0.1, "output_interval": 0.1, "output": names}
    found = fmpy.simulate_fmu(str(unit), fmi_type="CoSimulation", start_values=given, **ends)[-1]

    def rates(_: float, state: Array) -> Array:
        return np.concatenate((state[3:], case.accelerate(state[:3], state[3:], 1.0)[0]))

    expected = solve_ivp(rates, (0, 0.1), np.concatenate(START), "DOP853", rtol=1e-11, atol=1e-11).y[:3, -1]
    assert [found[name] for name in names] == pytest.approx(list(place(expected)), abs=1e-9)


DRIVEN = """\
name: valve
gravity: [0, 0, -9.81]
bodies:
  - {name: wheel, joint: {name: q1, type: revolute, axis: y, actuated: false}, mass: 1, inertia: [0.1, 0.1, 0.1]}
  - {name: valve, joint: {name: q2, type: prismatic, axis: z, actuated: false}, mass: 1}
constraints:
  - {name: cam, equation: q2 - 0.1*sin(q1)}
driven: [q1]
"""
HANGING = """\
  - {name: bob, parent: valve, joint: {name: q3, type: revolute, axis: y, actuated: false}, mass: 1, com: [0, 0, -1]}
"""


@pytest.mark.parametrize("hangs", [False, True])
def test_the_command_linearises_about_driven_joints(
    requires: Callable[[str], str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hangs: bool
) -> None:
    """A pendulum of 1 m swings on the valve, whose cam bears 2 kg 0.1 m at rest; without it, nothing moves."""
    requires("cc")
    file = tmp_path / "valve.yaml"
    file.write_text(DRIVEN.replace("constraints:", f"{HANGING}constraints:") if hangs else DRIVEN, encoding="utf-8")
    monkeypatch.setattr(sys, "argv", ["mbsrun", "linearise", str(file), "-o", str(tmp_path / "out")])
    if not hangs:
        kernels = load(file, extent=INTEGRATED)
        with pytest.raises(BalanceError, match="driven joints determine the whole motion of valve"):
            settle(kernels, find_pose(kernels, {}), np.zeros(0))
        return
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert not end.value.code
    found = json.loads((tmp_path / "out" / "linearisation.json").read_text(encoding="utf-8"))
    assert found["driven"] == {"q1": pytest.approx(0.2 * 9.81)}
    assert found["freedoms"] == ["q3"]
    assert found["modes"][0]["pole"] == pytest.approx([0, np.sqrt(9.81)])
