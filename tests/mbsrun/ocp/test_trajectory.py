"""Motions on grids, read on others: polynomials, which every reading keeps, and means of inputs by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from mbsrun.ocp.ground.trajectory import Trajectory, average_inputs, hold_numbers, lagrange, move_ahead, resample

Array = NDArray[np.float64]
NODES = {"radau": (0.4, 1.0), "lobatto": (0.0, 0.5, 1.0)}
SHIFTED = {"q": (1, 2, -1), "v": (3, -1), "s": (0.5, 1, 1)}  # coefficients of polynomials in t


def lay(mesh: Array, nodes: tuple[float, ...]) -> Array:
    return np.asarray(mesh[:-1, None] + np.outer(np.diff(mesh), nodes))


def make(nodes: tuple[float, ...], **changed: Any) -> Trajectory:
    """Make a motion of one coordinate on [0, 2], of which q, qd and s are polynomials of degree 2 at most."""
    mesh = np.array([0.0, 0.5, 1.0, 2.0])
    points = lay(mesh, nodes)
    q, v, s = (Polynomial(x) for x in SHIFTED.values())
    return replace(
        Trajectory(
            t=mesh, q=q(mesh)[:, None], qd=v(mesh)[:, None], u=np.array([[1.0], [3.0], [-1.0]]), point_t=points,
            point_q=q(points)[..., None], point_qd=v(points)[..., None], point_qdd=(3 * points - 1)[..., None],
            states=s(mesh)[:, None], point_states=s(points)[..., None], controls=np.array([[2.0], [4.0], [6.0]]),
        ),
        **changed,
    )  # fmt: skip


@pytest.mark.parametrize("family", NODES)
def test_polynomials_are_read_on_another_grid_and_pace(family: str) -> None:
    """On half the horizon all goes at twice the pace; of the first point at the start, the value is the mesh's."""
    own = make(NODES[family])
    if family == "lobatto":  # what stands at the first points is not read
        point_q = own.point_q.copy()
        point_q[:, 0] = np.nan
        own = replace(own, point_q=point_q)
    mesh = np.array([0.0, 0.3, 1.0])
    points = lay(mesh, (0.25, 0.75))
    found = resample(own, mesh, points)
    q, v, s = (Polynomial(x) for x in SHIFTED.values())
    assert found.q[:, 0] == pytest.approx(q(2 * mesh), abs=1e-13)
    assert found.point_q[..., 0] == pytest.approx(q(2 * points), abs=1e-13)
    assert found.qd[:, 0] == pytest.approx(2 * v(2 * mesh), abs=1e-13)
    assert found.point_qd[..., 0] == pytest.approx(2 * v(2 * points), abs=1e-13)
    assert found.point_qdd[..., 0] == pytest.approx(4 * (6 * points - 1), abs=1e-12)
    assert found.states[:, 0] == pytest.approx(s(2 * mesh), abs=1e-13)
    assert found.point_states[..., 0] == pytest.approx(s(2 * points), abs=1e-13)
    assert found.u[:, 0] == pytest.approx([(0.5 + 0.3) / 0.6, (0.4 * 3 - 1) / 1.4], abs=1e-13)
    assert found.controls[:, 0] == pytest.approx([(1.0 + 0.4) / 0.6, (1.6 + 6) / 1.4], abs=1e-13)
    assert (found.t.tolist(), found.point_t.tolist()) == (mesh.tolist(), points.tolist())


def test_each_time_is_read_in_its_own_interval() -> None:
    """A motion with a kink at each mesh point, a polygon."""
    own = make(NODES["radau"])
    corners = np.array([0.0, 2.0, -1.0, 3.0])
    q, point_q = (np.interp(t, own.t, corners)[..., None] for t in (own.t, own.point_t))
    mesh = np.array([0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0])
    points = lay(mesh, (0.4, 1.0))
    found = resample(replace(own, q=q, point_q=point_q, point_qdd=own.u[:, None] + 0 * own.point_qdd), mesh, points)
    assert found.q[:, 0] == pytest.approx(np.interp(mesh, own.t, corners), abs=1e-13)
    assert found.point_q[..., 0] == pytest.approx(np.interp(points, own.t, corners), abs=1e-13)
    assert found.point_qdd[:, 0, 0] == pytest.approx([1, 1, 3, 3, -1, -1])
    assert found.point_qdd[:, 1, 0] == pytest.approx([1, 1, 3, 3, -1, -1])  # at a kink, the interval before it


def test_inputs_at_points_are_read_off_their_own_polynomials() -> None:
    """Of degree 1 through two points; the ones of controls and of wrenches likewise."""
    own = make(NODES["radau"])
    linear = (5 * own.point_t)[..., None]
    own = replace(own, point_u=linear, point_controls=-linear, point_w=2 * linear)
    points = lay(np.array([0.0, 1.1, 2.0]), (0.25, 0.75))
    found = resample(own, np.array([0.0, 1.1, 2.0]), points)
    for array, factor in ((found.point_u, 5), (found.point_controls, -5), (found.point_w, 10)):
        assert array[..., 0] == pytest.approx(factor * points, abs=1e-12)


def test_a_motion_that_moves_ahead_goes_on_until_its_end_and_then_stands() -> None:
    """From t = 1.4 on; beyond 2 the pose stays, the velocities are 0, and the last inputs go on."""
    own = make(NODES["radau"])
    mesh = np.array([0.0, 0.4, 0.6, 1.0])
    points = lay(mesh, (0.4, 1.0))
    found = move_ahead(own, 1.4, mesh, points)
    q, v, s = (Polynomial(x) for x in SHIFTED.values())
    later, later_points = np.minimum(mesh + 1.4, 2.0), np.minimum(points + 1.4, 2.0)
    moves, points_move = mesh + 1.4 <= 2 + 1e-9, points + 1.4 <= 2 + 1e-9
    assert found.q[:, 0] == pytest.approx(q(later), abs=1e-13)
    assert found.qd[:, 0] == pytest.approx(v(later) * moves, abs=1e-13)
    assert found.qd[2, 0] != 0  # at the end itself it still moves
    assert found.point_q[..., 0] == pytest.approx(q(later_points), abs=1e-13)
    assert found.point_qd[..., 0] == pytest.approx(v(later_points) * points_move, abs=1e-13)
    assert found.point_qdd[..., 0] == pytest.approx((3 * later_points - 1) * points_move, abs=1e-12)
    assert found.states[:, 0] == pytest.approx(s(later), abs=1e-13)
    assert found.point_states[..., 0] == pytest.approx(s(later_points), abs=1e-13)
    assert found.u[:, 0] == pytest.approx([-1.0, -1.0, -1.0])
    early = move_ahead(own, 0.25, np.array([0.0, 0.5, 1.0]), lay(np.array([0.0, 0.5, 1.0]), (0.4, 1.0)))
    assert early.u[:, 0] == pytest.approx([2.0, 1.0])
    assert early.controls[:, 0] == pytest.approx([3.0, 5.0])


def test_means_of_inputs_are_integrals_over_lengths() -> None:
    """Two inputs at once; after the end the last ones stay, however far."""
    t, u = np.array([0.0, 1.0, 3.0]), np.array([[2.0, 0.0], [-1.0, 6.0]])
    found = average_inputs(t, u, np.array([0.0, 0.5, 1.5, 3.0, 30.0]))
    assert found == pytest.approx(np.array([[2, 0], [0.5, 3], [-1, 6], [-1, 6]]), abs=1e-14)


def test_basis_polynomials_are_1_at_their_node() -> None:
    """And 0 at the others; together they keep every polynomial through as many values."""
    nodes = np.array([0.1, 0.5, 0.9])
    assert lagrange(nodes, nodes) == pytest.approx(np.eye(3))
    x = np.array([[0.0, 0.3], [0.7, 1.0]])
    assert lagrange(nodes, x) @ (nodes**2 - nodes) == pytest.approx(x**2 - x, abs=1e-14)


def test_inputs_that_are_constant_are_spread_over_the_points() -> None:
    own = make(NODES["radau"])
    u, controls = own.spread_inputs()
    assert u.tolist() == [[[1.0]] * 2, [[3.0]] * 2, [[-1.0]] * 2]
    assert controls[:, 1, 0].tolist() == [2.0, 4.0, 6.0]
    given = np.arange(6.0).reshape(3, 2, 1)
    u, controls = replace(own, point_u=given).spread_inputs()
    assert (u.tolist(), controls[:, 0, 0].tolist()) == (given.tolist(), [2.0, 4.0, 6.0])


@pytest.mark.parametrize(
    "part",
    [
        {"t": np.zeros(3)},
        {"q": np.zeros((3, 1))},
        {"q": np.zeros(4)},
        {"qd": np.zeros((4, 2))},
        {"u": np.zeros((4, 1))},
        {"point_t": np.zeros((3, 3))},
        {"point_q": np.zeros((3, 2, 2))},
        {"point_qdd": np.zeros((3, 1, 1))},
        {"states": np.zeros((3, 1))},
        {"states": np.zeros((4, 2))},
        {"point_states": np.zeros((2, 2, 1))},
        {"controls": np.zeros((4, 1))},
        {"point_u": np.zeros((3, 2, 2))},
        {"point_controls": np.zeros((3, 2, 2))},
        {"point_w": np.zeros((3, 1, 1))},
        {"slopes": np.zeros((4, 3))},
    ],
)
def test_arrays_that_do_not_fit_together_are_refused(part: dict[str, Array]) -> None:
    with pytest.raises(ValueError, match="do not fit together"):
        make(NODES["radau"], **part)


def test_a_motion_shows_its_sizes_and_fills_what_it_leaves_out() -> None:
    own = make(NODES["radau"])
    assert repr(own) == "Trajectory(2 s, 3 intervals of 2 points, 1 coordinates, 1 inputs)"
    assert (own.point_u.shape, own.point_controls.shape, own.point_w.shape) == ((3, 2, 0),) * 3
    assert (own.slopes.shape, own.unknowns.shape) == ((3, 0), (0,))
    bare = make(NODES["radau"], states=np.zeros(0), point_states=np.zeros(0), controls=np.zeros(0))
    assert (bare.states.shape, bare.point_states.shape, bare.controls.shape) == ((4, 0), (3, 2, 0), (3, 0))


def test_numbers_that_hold_still_are_the_last_states_everywhere() -> None:
    own = make(NODES["radau"], unknowns=np.array([5.0, 6.0]))
    held = hold_numbers(own, own.unknowns)
    assert held.unknowns.size == 0
    for name in ("states", "point_states"):
        before, after = getattr(own, name), getattr(held, name)
        assert (after[..., :-2] == before).all()
        assert (after[..., -2:] == [5.0, 6.0]).all()
