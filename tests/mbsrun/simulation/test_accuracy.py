"""Orders, energies and momenta of every method, against closed forms and laws of mechanics.

The pendulum is IFToMM's A01: 1 kg on 1 m, let go horizontally. Its angle is given by Jacobi's functions,
sin(q/2) = k cd(w t, k) with k = sin(q0/2) and w = sqrt(g/l), which the reference file has been computed from with 40
digits. Figures called measured are of an independent implementation.
"""

from __future__ import annotations

import json
from math import pi, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import ellipj

from mbsgen.expressions import parse
from mbsrun import Mechanism, load
from mbsrun.simulation import METHODS, Formulation, Motion, Settings, simulate
from mbsrun.simulation.drive import Drive, express, hold, hold_steps
from mbsrun.simulation.dynamics import Dynamics, SingularError
from mbsrun.simulation.integration.methods import Family
from mbsrun.simulation.motion import Energy

REFERENCE = json.loads((Path(__file__).parents[2] / "reference" / "iftomm_A01_pendulum.json").read_text())
REST = hold(np.zeros(4))  # the bench's inputs: of the slider, and a force on the bob
LEVEL = [pi / 2, 0, 0]


def swing(bench: Mechanism, **settings: Any) -> Motion:
    """Release the pendulum alone."""
    return simulate(bench, REST, LEVEL, [0, 0, 0], Settings(**settings))


def exact(t: float) -> float:
    """Return the angle of the pendulum released at pi/2."""
    k = sqrt(0.5)
    _, cn, dn, _ = ellipj(sqrt(9.81) * t, k**2)
    return float(2 * np.arcsin(k * cn / dn))


def place(motion: Motion) -> Any:
    q = motion.q[-1, 0]
    return np.array([np.sin(q), -np.cos(q)])


@pytest.mark.parametrize("t", [1, 5, 10])
def test_the_closed_form_is_the_reference(t: int) -> None:
    """ellipj keeps some 13 digits at these arguments."""
    x, y = map(float, REFERENCE["xy_start_plus1"][str(t)])
    assert np.allclose([np.sin(exact(t)), -np.cos(exact(t))], [x, y], rtol=0, atol=1e-12)


ORDERS = {
    "euler": ({"method": "euler"}, 1, 2e-3),
    "symplectic Euler": ({"method": "symplectic-euler"}, 1, 2e-3),
    "rk4": ({"method": "rk4"}, 4, 0.02),
    "generalised alpha": ({"method": "generalized-alpha"}, 2, 0.01),
    "generalised alpha, no damping": ({"method": "generalized-alpha", "rho": 1.0}, 2, 0.01),
    "generalised alpha, all damping": ({"method": "generalized-alpha", "rho": 0.0}, 2, 0.01),
    "variational": ({"method": "variational"}, 2, 0.01),
    "implicit Euler": ({"method": "radau-iia", "stages": 1}, 1, 2e-3),
    "Radau 2": ({"method": "radau-iia", "stages": 2}, 3, 0.02),
    "Radau 3": ({"method": "radau-iia", "stages": 3}, 5, 0.05),
    "midpoint": ({"method": "gauss", "stages": 1}, 2, 0.01),
    "Gauss 2": ({"method": "gauss", "stages": 2}, 4, 0.04),
    "Gauss 3": ({"method": "gauss", "stages": 3}, 6, 0.08),
}


@pytest.mark.parametrize(("settings", "order", "step"), ORDERS.values(), ids=ORDERS.keys())
def test_methods_with_a_fixed_step_have_their_order(
    bench: Mechanism, settings: dict[str, Any], order: int, step: float
) -> None:
    """Halving the step divides the error of the pendulum by 2^order, to a tenth of an order (at least)."""
    errors = [abs(swing(bench, duration=0.8, step=h, **settings).q[-1, 0] - exact(0.8)) for h in (step, step / 2)]
    assert errors[1] > 1e-13, "the error must not be rounding"
    assert np.log2(errors[0] / errors[1]) >= order - 0.1


@pytest.mark.parametrize("method", [name for name, x in METHODS.items() if x.family is Family.ADAPTIVE])
def test_adaptive_methods_keep_their_tolerance(bench: Mechanism, method: str) -> None:
    """A tolerance of 1e-9 a step gives at most a thousand times that after 2 s (some hundred steps)."""
    motion = swing(bench, duration=2.0, method=method)
    assert abs(motion.q[-1, 0] - exact(2.0)) < 1e-6
    assert motion.energy is not None
    assert np.abs(motion.energy.drift).max() < 1e-5
    inside = len(motion.t) // 2
    assert abs(motion.q[inside, 0] - exact(motion.t[inside])) < 1e-6, "between its steps too"


def test_a_spring_swings_as_it_should(bench: Mechanism) -> None:
    """x = x0 cos(w t) with w^2 = k/m = 40/0.3; damped, the energy lost is the damper's work."""
    t, w = 1.0, sqrt(40 / 0.3)
    settings = Settings(t, "rk4", step=1e-4)
    motion = simulate(bench, REST, [0, 0.1, 0], [0, 0, 0], settings)
    assert motion.q[-1, 1] == pytest.approx(0.1 * np.cos(w * t), abs=1e-9)
    damped = simulate(bench.with_parameters(c=0.6), REST, [0, 0.1, 0], [0, 0, 0], settings)
    rate = sqrt(w**2 - 1)  # c / 2 m = 1
    assert damped.q[-1, 1] == pytest.approx(0.1 * np.exp(-t) * (np.cos(rate * t) + np.sin(rate * t) / rate), abs=1e-9)


@pytest.mark.parametrize("rho", [0.0, 0.5, 1.0])
def test_newton_s_method_ends_at_once_for_a_linear_mechanism(bench: Mechanism, rho: float) -> None:
    """The first change of a step solves its equations; the second one is rounding."""
    settings = Settings(1.0, "generalized-alpha", step=0.1, rho=rho)
    motion = simulate(bench.with_parameters(c=0.6), REST, [0, 0.1, 0], [0, 0, 0], settings)
    assert np.ptp(motion.q[:, 1]) > 0.05
    assert motion.effort.iterations <= 2 * motion.effort.steps


def test_work_is_told_apart_from_drift(bench: Mechanism, pendulum: Mechanism) -> None:
    """Springs, dampers, inputs and wrenches do work; what is left is the error of the method, here below 1e-9 J."""
    free = bench.with_parameters(c=2.0)
    push = express_inputs("0.3*sin(5*t)", "0.5", "t**2", "0")
    motion = simulate(free, push, [1, 0.1, 0], [0, 1, 1], Settings(2.0, "rk4", step=1e-3))
    assert motion.energy is not None
    assert np.abs(motion.energy.work).max() > 0.1
    assert np.abs(motion.energy.drift).max() < 1e-9
    rod = simulate(pendulum, express_inputs("2*cos(3*t)"), [1], [0], Settings(2.0, "dop853", rtol=1e-11, atol=1e-11))
    assert rod.energy is not None
    assert np.abs(rod.energy.work).max() > 0.1
    assert np.abs(rod.energy.drift).max() < 1e-8


def express_inputs(*texts: str) -> Drive:
    return express([parse(text) for text in texts], list(texts), {})


def test_a_wrench_holds_the_pendulum_up(bench: Mechanism) -> None:
    """With its weight taken off, the bob turns evenly."""
    motion = simulate(bench, hold([0, 0, 9.81, 0]), LEVEL, [3, 0, 0], Settings(2.0, "rk4", step=1e-2))
    assert np.allclose(motion.q[:, 0], pi / 2 + 3 * motion.t, rtol=0, atol=1e-12)


METHODS_ON_STEPS = ["rk4", "gauss", "dop853", "radau"]


@pytest.mark.parametrize("method", METHODS_ON_STEPS)
def test_inputs_that_jump_cost_no_order(bench: Mechanism, method: str) -> None:
    """Under forces held in steps a free mass moves on parabolas, which all these methods follow without error.

    The jumps lie at no multiple of the step; errors are rounding, or 1e-9 where a tolerance rules.
    """
    times, forces = [0, 0.1234, 0.77, 1.0], np.array([[3.0], [-6.0], [1.5]])
    free = bench.with_parameters(k=0.0)
    drive = hold_steps(times, np.hstack((forces, np.zeros((3, 3)))))
    motion = simulate(free, drive, [0, 0, 0], [0, 0, 0], Settings(1.0, method, step=0.05))
    x = v = 0.0
    for a, length in zip(forces[:, 0] / 0.3, np.diff(times), strict=True):
        x, v = x + v * length + a * length**2 / 2, v + a * length
    assert motion.q[-1, 1] == pytest.approx(x, abs=1e-8 if method == "radau" else 1e-12)
    assert motion.qd[-1, 1] == pytest.approx(v, abs=1e-8 if method == "radau" else 1e-12)
    assert np.isin(times, motion.t).all()
    assert motion.inputs[np.searchsorted(motion.t, 0.1234), 0] == -6.0


@pytest.mark.parametrize("method", ["rk4", "dop853", "gauss", "generalized-alpha"])
def test_formulations_agree(double_pendulum: Mechanism, method: str) -> None:
    """All four are the same equations: motions differ by rounding, which 0.3 s amplify little, and by Newton's rest."""
    inputs = hold(np.zeros(len(double_pendulum.manifest.actuated)))
    ends = [
        simulate(double_pendulum, inputs, [1.0, 0.5], [0.3, -2], Settings(0.3, method, formulation, step=5e-3)).q[-1]
        for formulation in Formulation
    ]
    assert np.abs(np.array(ends) - ends[0]).max() < 1e-11


def test_steps_in_c_are_those_of_the_textbook(bench: Mechanism) -> None:
    """The classical Runge-Kutta step, written out in Python, under inputs that change over time."""
    drive, h = express_inputs("sin(9*t)", "t", "0.3", "cos(t)"), 0.01
    damped = bench.with_parameters(c=0.7, b=0.2)

    def rate(t: float, y: Any) -> Any:
        v = drive.pieces[0].at(t)
        return np.concatenate((y[3:], damped("exp2", q=y[:3], qd=y[3:], u=v[:1], w=v[1:])["qdd"]))

    y = np.array([1.0, 0.2, 0.5, -1, 0.4, 0.1])
    start = y.copy()
    for k in range(50):
        t = k * h
        k1 = rate(t, y)
        k2 = rate(t + h / 2, y + h / 2 * k1)
        k3 = rate(t + h / 2, y + h / 2 * k2)
        k4 = rate(t + h, y + h * k3)
        y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    for formulation in Formulation:
        motion = simulate(damped, drive, start[:3], start[3:], Settings(0.5, "rk4", formulation, step=h))
        assert np.abs(np.concatenate((motion.q[-1], motion.qd[-1])) - y).max() < 1e-13


# --- energies over long times (F17), no drift of constraints (F16) ---------------------------------------------------


def test_runge_kutta_loses_energy_as_t_h5(bench: Mechanism) -> None:
    """Measured over 2000 s with h = 1e-2: 1.5e-5 J and 1.1e-3 m; with T and with h^5 it goes."""
    whole = swing(bench, duration=2000.0, method="rk4", step=1e-2)
    half = swing(bench, duration=1000.0, method="rk4", step=1e-2)
    fine = swing(bench, duration=200.0, method="rk4", step=5e-3)
    losses = [np.abs(x.energy.drift).max() for x in (whole, half, fine) if x.energy is not None]
    assert losses[0] == pytest.approx(1.5e-5, rel=0.1)
    assert losses[0] / losses[1] == pytest.approx(2, rel=0.02)
    assert losses[0] / 10 / losses[2] == pytest.approx(32, rel=0.1)
    reference = np.array(REFERENCE["xy_start_plus1"]["2000"], dtype=float)
    assert np.abs(place(whole) - reference).max() == pytest.approx(1.1e-3, rel=0.2)


def test_the_midpoint_rule_bounds_energy_but_not_phase(bench: Mechanism) -> None:
    """Measured with h = 1e-2: an energy error of 4e-4 J, bounded; yet the place is off by more and more."""
    motion = swing(bench, duration=20.0, method="gauss", stages=1, step=1e-2)
    assert motion.energy is not None
    drift, middle = np.abs(motion.energy.total - motion.energy.total[0]), len(motion.t) // 2
    assert drift.max() < 6e-4
    assert drift[middle:].max() == pytest.approx(drift[:middle].max(), rel=0.05)
    errors = np.abs(motion.q[:, 0] - [exact(t) for t in motion.t])
    assert errors.max() > 1e-3
    assert errors[middle:].max() > 1.5 * errors[:middle].max()


def step_in_momenta(kernels: Mechanism, x: Any, h: float, method: str, formulation: Formulation) -> Any:
    """Take one step of a method from x = (q, p) to (q', p'), with p = M(q) qd."""
    q, p = np.split(x, 2)
    qd = np.linalg.solve(kernels("semi", q=q, qd=np.zeros_like(q))["M"], p)
    drive = hold(np.zeros(len(kernels.manifest.actuated)))
    motion = simulate(kernels, drive, q, qd, Settings(h, method, formulation, step=h))
    assert motion.effort.steps == 1
    q, qd = motion.q[-1], motion.qd[-1]
    return np.concatenate((q, kernels("semi", q=q, qd=qd)["M"] @ qd))


@pytest.mark.parametrize(
    ("method", "formulation"),
    [
        ("symplectic-euler", Formulation.IMPL),
        ("symplectic-euler", Formulation.SEMI),
        ("variational", Formulation.IMPL),
        ("variational", Formulation.SEMI),
    ],
)
def test_symplectic_steps_are_symplectic_in_momenta(
    double_pendulum: Mechanism, lock: Mechanism, method: str, formulation: Formulation
) -> None:
    """The Jacobian J of a step keeps the canonical form: J^T W J = W, though M depends on q.

    Differences over e = 1e-4 err by e^2 and eps/e, here below 1e-6. Velocities by the accelerations at the step's begin
    (a method of this name that is symplectic only for constant M) miss by 2.4.
    """
    h, e = 0.05, 1e-4
    for kernels, x in ((double_pendulum, [1.5, 1.0, 2.0, -1.0]), (lock, [0.3, 0.5, -0.4, 2.0, -3.0, 1.0])):
        n = len(x) // 2
        ends = [
            [step_in_momenta(kernels, np.array(x) + sign * e * unit, h, method, formulation) for sign in (1, -1)]
            for unit in np.eye(2 * n)
        ]
        J = np.array([(a - b) / (2 * e) for a, b in ends]).T
        W = np.block([[np.zeros((n, n)), np.eye(n)], [-np.eye(n), np.zeros((n, n))]])
        assert np.abs(J.T @ W @ J - W).max() < 1e-6
        assert np.abs(J - np.eye(2 * n)).max() > 0.1, "the step moves"


def test_symplectic_euler_bounds_energy_where_the_mass_matrix_changes(double_pendulum: Mechanism) -> None:
    """A double pendulum let go high, 20 s with h = 1e-2: the energy swings by 1.5 J, and goes nowhere.

    Where velocities follow the accelerations at the step's begin, it loses 5 J in that time, and more in more.
    """
    motion = simulate(double_pendulum, hold([]), [1.5, 1.0], [0, 0], Settings(20.0, "symplectic-euler", step=1e-2))
    assert motion.energy is not None
    error = motion.energy.total - motion.energy.total[0]
    middle = len(error) // 2
    assert np.abs(error).max() < 2.0
    assert abs(error[:middle].mean() - error[middle:].mean()) < 0.3


def test_damping_takes_energy_from_symplectic_euler_as_it_should(bench: Mechanism) -> None:
    """The slider creeps, with steps a hundred times as long as an explicit method's: (1 - 20 h)^500 is 0.9 exp(-10)."""
    stiff = bench.with_parameters(k=8e5, c=4e4)
    motion = simulate(stiff, REST, [1, 0.01, 0], [0, 0, 0], Settings(0.5, "symplectic-euler", step=1e-3))
    assert motion.is_complete
    assert motion.q[-1, 1] == pytest.approx(0.01 * np.exp(-20 * 0.5), rel=0.12)
    assert not any("stiff" in warning for warning in motion.warnings)


def test_implicit_euler_damps(bench: Mechanism) -> None:
    """Its losses are reported as drift, with a warning."""
    motion = swing(bench, duration=3.0, method="radau-iia", stages=1, step=1e-2)
    assert motion.energy is not None
    assert motion.energy.total[-1] - motion.energy.total[0] < -1.0
    assert any("energy drifts" in warning for warning in motion.warnings)


def test_joint_coordinates_do_not_drift_off_the_rod(bench: Mechanism) -> None:
    """RK4 with h = 1e-2 for 10 s: in Cartesian coordinates the rod's length drifts by 3.6e-5 (measured); here by none.

    The position errs by less than the measured bound of the best stabilisation there, twice 3.6e-5.
    """
    motion = swing(bench, duration=10.0, method="rk4", step=1e-2)
    tips = bench("sensors", q=motion.q)["position"][:, :, 0]
    assert np.abs(np.linalg.norm(tips, axis=1) - 1).max() < 4 * np.finfo(float).eps
    reference = np.array(REFERENCE["xy_start_plus1"]["10"], dtype=float)
    assert np.abs(place(motion) - reference).max() < 2 * 3.6e-5


# --- stiffness (F18) -------------------------------------------------------------------------------------------------

EIGENVALUE = 1.33e5  # 1/s: of c = 4e4 N s/m on 0.3 kg


@pytest.fixture(scope="module")
def stiff(bench: Mechanism) -> Mechanism:
    return bench.with_parameters(k=8e5, c=4e4)


def test_stiff_motion_limits_explicit_steps_and_that_is_told(stiff: Mechanism) -> None:
    """Measured: steps of Runge-Kutta up to 2.1e-5 s; some t lambda / 3.3 steps of six evaluations by RK45."""
    start = [1, 0.01, 0]
    stable = simulate(stiff, REST, start, [0, 0, 0], Settings(0.05, "rk4", step=2.0e-5))
    assert stable.is_complete
    assert not any("stiff" in warning for warning in stable.warnings)
    unstable = simulate(stiff, REST, start, [0, 0, 0], Settings(0.5, "rk4", step=2.2e-5))
    assert unstable.halt is not None
    assert unstable.halt.joint == "slider"
    assert 0 < unstable.halt.time < 0.5
    assert np.isfinite(unstable.q).all()
    adaptive = simulate(stiff, REST, start, [0, 0, 0], Settings(0.02, "rk45"))
    assert adaptive.effort.evaluations == pytest.approx(0.02 * EIGENVALUE / 3.3 * 6, rel=0.5)
    for motion in (unstable, adaptive):
        assert any("stiff: motion of joint slider decays at 1.33e+05" in warning for warning in motion.warnings)


def test_implicit_methods_take_long_steps_through_stiff_motion(stiff: Mechanism) -> None:
    """10 s take fewer than 2000 evaluations, and agree with a run ten times as tight to 1e-6."""
    start, ends = [1, 0.01, 0], []
    for tolerance in (2e-6, 2e-7):
        settings = Settings(10.0, "radau", rtol=tolerance, atol=tolerance)
        motion = simulate(stiff, REST, start, [0, 0, 0], settings)
        assert motion.warnings == ()
        ends.append(motion)
    assert ends[0].effort.evaluations < 2000
    assert np.abs(ends[0].q[-1] - ends[1].q[-1]).max() < 1e-6


@pytest.mark.parametrize("method", ["radau-iia", "generalized-alpha"])
def test_implicit_steps_on_the_residual_hold_on_stiff_motion(stiff: Mechanism, method: str) -> None:
    """Steps 500 times as long as explicit ones: the slider creeps back, exp(-k/c t), the pendulum swings on.

    Errors are of order 3 and 2 with h = 1e-2, where the slider moves 1e-2 m at a rate of 20 1/s.
    """
    settings = Settings(0.5, method, Formulation.IMPL, step=1e-2, rho=0.0)
    motion = simulate(stiff, REST, [pi / 2, 0.01, 0], [0, 0, 0], settings)
    assert motion.is_complete
    assert abs(motion.q[-1, 1] - 0.01 * np.exp(-20 * 0.5)) < 1e-4
    assert abs(motion.q[-1, 0] - exact(0.5)) < 2e-3


def test_a_motion_that_exchanges_no_energy_may_round() -> None:
    """A freely turning body keeps its kinetic energy; rounding is no drift, a millionth is."""
    nothing, ripple = np.zeros(3), np.array([0.0, 1.0, -1.0])
    assert Energy(6.0 + 1e-11 * ripple, nothing, nothing).is_kept
    assert not Energy(6.0 + 1e-6 * ripple, nothing, nothing).is_kept
    assert Energy(6.0 + ripple, 3.0 - 0.99 * ripple, nothing).is_kept
    assert not Energy(6.0 + ripple, 3.0 - 0.9 * ripple, nothing).is_kept


def test_many_steps_near_rest_round_more_than_one() -> None:
    """A mechanism of 100 J of potential energy that hardly moves: 10,000 roundings of 1e-14 J sum up to 1e-10 J."""
    K = 10_001
    rounded, potential, still = np.linspace(0.0, 1e-10, K), np.full(K, 100.0), np.full(K, 1e-12)
    assert Energy(still, potential + rounded, np.zeros(K)).is_kept
    assert not Energy(still, potential + 1e3 * rounded, np.linspace(0.0, 0.9e-7, K)).is_kept


# --- momentum --------------------------------------------------------------------------------------------------------

FLYER = """
name: flyer
gravity: [0, 0, -9.81]
bodies:
  - name: trunk
    joint: {type: floating}
    mass: 4
    com: [0.01, 0, 0.02]
    inertia: {xx: 0.02, yy: 0.05, zz: 0.06, xz: 1e-3}
  - name: leg
    parent: trunk
    joint: {type: revolute, axis: y, position: [0.2, 0.1, 0]}
    mass: 0.8
    com: [0, 0.01, -0.1]
    inertia: [0.003, 0.003, 0.001]
"""


@pytest.fixture(scope="module")
def flyer(tmp_path_factory: pytest.TempPathFactory) -> Mechanism:
    file = tmp_path_factory.mktemp("flyer") / "flyer.yaml"
    file.write_text(FLYER, encoding="utf-8")
    return load(file)


@pytest.mark.parametrize("method", ["dop853", "gauss"])
def test_what_flies_keeps_its_momentum(flyer: Mechanism, method: str) -> None:
    """Inner torques change neither p = p0 + m g t nor the spin about the centre of mass, L - r x p."""
    q, qd = [0, 0, 1, 0.1, 0.2, 0.3, -0.4], [1, 0, 2, 0.5, -1, 2, 0.3]
    settings = Settings(1.0, method, step=2e-3, rtol=1e-11, atol=1e-11, stages=3)
    motion = simulate(flyer, express_inputs("0.4*sin(7*t)"), q, qd, settings)
    found = flyer("energy", q=motion.q, qd=motion.qd)
    fall = np.outer(motion.t, [0, 0, -9.81 * 4.8])
    spin = found["angular_momentum"] - np.cross(found["com"], found["momentum"])
    assert np.abs(found["momentum"] - fall - found["momentum"][0]).max() < 2e-7
    assert np.abs(spin - spin[0]).max() < 1e-8
    assert np.abs(np.diff(motion.q[:, 6])).max() > 0, "the leg moves"


def test_masses_of_many_states_are_judged_one_by_one(lock: Mechanism) -> None:
    """A stack of 2, and one of 4, of three joints: each system is solved, and one that is lost names its joint."""
    dynamics = Dynamics(lock, Formulation.SEMI)
    q = np.array([[0.3, 0.4, 0.1], [0.1, -1.2, 2.0], [0.0, 0.5, 0.0], [1.0, 1.5, -0.4]])
    M = np.asarray(lock("semi", q=q, qd=np.zeros_like(q))["M"])
    right = np.arange(12.0).reshape(4, 3)
    for count in (2, 4):
        found = dynamics.solve(M[:count], right[:count])
        expected = [np.linalg.solve(M[k], right[k]) for k in range(count)]
        assert found == pytest.approx(np.array(expected), rel=1e-12)
    lost = M.copy()
    lost[2] = lock("semi", q=np.array([0.0, np.pi / 2, 0.0]), qd=np.zeros(3))["M"]
    with pytest.raises(SingularError, match="third"):
        dynamics.solve(lost, right)
