"""The model behind bioptim's protocol: identities of mechanics among its functions, and refusals."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import mbsrun
from mbsrun.peers.bioptim import BioptimModel
from mbsrun.peers.peer import PeerError

MODELS = Path(__file__).parents[3] / "models"
NONE = np.zeros((0, 1))
PROTOCOL = (  # names that bioptim's protocol has for rigid bodies without contacts
    "name copy serialize friction_coefficients nb_tau nb_segments segment_index nb_quaternions nb_dof nb_q nb_qdot "
    "nb_qddot nb_root segments center_of_mass center_of_mass_velocity reshape_qdot name_dof contact_names "
    "nb_soft_contacts soft_contact_names muscle_names torque forward_dynamics inverse_dynamics marker markers "
    "nb_markers marker_index nb_rigid_contacts markers_velocities marker_velocity tau_max marker_names "
    "normalize_state_quaternions bounds_from_ranges lagrangian"
)


@pytest.fixture(scope="module")
def arm() -> BioptimModel:
    return BioptimModel(MODELS / "planar_arm.yaml")


def test_it_has_the_names_of_the_protocol(arm: BioptimModel) -> None:
    assert [name for name in PROTOCOL.split() if not hasattr(arm, name)] == []
    assert (arm.nb_q, arm.nb_tau, arm.name_dof, arm.marker_names) == (2, 2, ("shoulder", "elbow"), ("hand",))
    assert arm.marker_index("hand") == 0
    assert arm.segments == ("upper", "fore")
    assert arm.segment_index("fore") == 1
    assert arm.ranges_from_model("q")[1].max() == 2.5
    assert arm.ranges_from_model("qdot")[0].min() == -np.inf
    make, arguments = arm.serialize()
    assert make(**arguments).name == arm.copy().name == "planar_arm"


def test_inverse_dynamics_undo_forward_dynamics(arm: BioptimModel, rng: np.random.Generator) -> None:
    """And M qddot + c = tau; derivatives by CasADi are the kernels'."""
    q, qdot, tau = rng.uniform(-1, 1, (3, 2))
    qddot = arm.forward_dynamics()(q, qdot, tau, NONE, NONE)
    assert np.abs((arm.inverse_dynamics()(q, qdot, qddot, NONE, NONE) - tau).full()).max() <= 1e-13
    M, c = arm.mass_matrix()(q, NONE), arm.non_linear_effects()(q, qdot, NONE)
    assert np.abs((M @ qddot + c - tau).full()).max() <= 1e-13
    forward = arm.forward_dynamics()
    value = forward(arm.q, qdot, tau, NONE, NONE)
    slope = ca.Function("slope", [arm.q], [ca.jacobian(value, arm.q)])(q)
    kernel = mbsrun.external.load_on_demand(MODELS / "planar_arm.yaml")("jac_exp2", q=q, qd=qdot, u=tau)
    assert np.abs((slope - kernel["jac_qdd_q"]).full()).max() <= 1e-13


def test_lagrange_s_equation_is_inverse_dynamics(arm: BioptimModel, rng: np.random.Generator) -> None:
    """tau = d/dt dL/dqdot - dL/dq."""
    q, qdot, qddot = rng.uniform(-1, 1, (3, 2))
    L = arm.lagrangian()(arm.q, arm.qdot)
    p = ca.gradient(L, arm.qdot)
    left = ca.jtimes(p, arm.q, arm.qdot) + ca.jtimes(p, arm.qdot, arm.qddot) - ca.gradient(L, arm.q)
    tau = ca.Function("tau", [arm.q, arm.qdot, arm.qddot], [left])(q, qdot, qddot)
    assert np.abs((tau - arm.inverse_dynamics()(q, qdot, qddot, NONE, NONE)).full()).max() <= 1e-12


def test_points_move_as_their_positions_do(arm: BioptimModel, rng: np.random.Generator) -> None:
    """The hand is at the end of two rods; a velocity is the derivative of its position."""
    q, qdot = rng.uniform(-1, 1, (2, 2))
    a, b = q[0], q[0] + q[1]
    hand = [0.4 * np.cos(a) + 0.3 * np.cos(b), 0.4 * np.sin(a) + 0.3 * np.sin(b), 0.0]
    assert np.abs(arm.marker(0)(q, NONE).full().ravel() - hand).max() <= 1e-15
    assert np.abs(arm.markers()(q, NONE).full().ravel() - hand).max() <= 1e-15
    for position, velocity in (
        (arm.marker(0), arm.marker_velocity(0)),
        (arm.markers(), arm.markers_velocities()),
        (arm.center_of_mass(), arm.center_of_mass_velocity()),
    ):
        moved = ca.jtimes(ca.vec(position(arm.q, NONE)), arm.q, arm.qdot)
        expected = ca.Function("v", [arm.q, arm.qdot], [moved])(q, qdot)
        assert np.abs((ca.vec(velocity(q, qdot, NONE)) - expected).full()).max() <= 1e-14
    assert np.array_equal(arm.reshape_qdot()(q, qdot, NONE).full().ravel(), qdot)
    assert float(arm.tau_max()(q, qdot, NONE)[1][0]) == -np.inf


def test_what_bioptim_could_not_solve_is_refused(arm: BioptimModel) -> None:
    with pytest.raises(PeerError, match="cart_pole has passive joints, pole, and bioptim gives each a torque; actuate"):
        BioptimModel(MODELS / "cart_pole.yaml")
    with pytest.raises(PeerError, match="satellite has quaternions, and bioptim gives it q, qd and u alone"):
        BioptimModel(MODELS / "satellite.yaml")
    with pytest.raises(PeerError, match="bioptim asks for contacts, which these models do not have"):
        arm.forward_dynamics(with_contact=True)
    with pytest.raises(PeerError, match="muscle_joint_torque"):
        arm.muscle_joint_torque()
    with pytest.raises(ValueError, match="found tau; give q, qdot or qddot"):
        arm.ranges_from_model("tau")
