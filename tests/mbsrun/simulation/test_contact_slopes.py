"""Derivatives through rigid contacts: the implicit function theorem on the laws of contact, by complex steps."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsrun.simulation.contact_variation import ContactField
from mbsrun.simulation.integration.contacts import Loads, Mode, State, Touch
from mbsrun.simulation.integration.touching import Bound, Guard, Passage, Strike
from mbsrun.simulation.motion import Segment
from mbsrun.simulation.variation import SlopeError
from tests.mbsrun.simulation.curved import NQ, PIECE, POINTS, TINY, Law, N, drive, make, slope

Array = NDArray[np.float64]
OPEN, STICK, SLIP = State.OPEN, State.STICK, State.SLIP
SIZE = NQ + N
TIME = 0.7
MODES = [(OPEN, OPEN, OPEN), (STICK, SLIP, OPEN), (OPEN, STICK, SLIP), (SLIP, SLIP, STICK), (SLIP, OPEN, OPEN)]


def place(dynamics: Any, states: tuple[State, ...], seed: int, sign: float = 1.0) -> tuple[Array, Array, Mode]:
    """Draw a state in which sticking points are at rest, and the mode with the ways of slipping ones."""
    rng, shape = np.random.default_rng(seed), dynamics.kernels.shape
    q, qd = rng.standard_normal(NQ), rng.standard_normal(N)
    held = [k for k, x in enumerate(states) if x == STICK and shape.friction[k] > 0]
    S, n = shape.read("slide", q), shape.normal(q)
    if held:
        rows = np.concatenate([S[k] for k in held])
        qd = qd - np.linalg.pinv(rows) @ (rows @ qd)
    v = np.einsum("pin,n->pi", S, qd)
    slip = v - n * (n * v).sum(axis=1, keepdims=True)
    ways = slip / np.maximum(np.linalg.norm(slip, axis=1, keepdims=True), 1e-9)
    return q, qd, Mode(states, sign * ways, np.ones(POINTS))


def find(law: Law, q: Array, qd: Array, guess: Array | None = None) -> tuple[Array, Array]:
    """Return the parameters and the solution of a law."""
    p = np.concatenate((q, qd, np.zeros(POINTS) if guess is None else guess))
    return p, law.solve(p, np.concatenate((qd, np.ones(law.count() - N))))


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("states", MODES)
def test_accelerations_and_forces_are_differentiated(states: tuple[State, ...], sign: float) -> None:
    """Of two states at once; slipping points go on along or against the way in which they began."""
    dynamics = make(5)
    field: Any = ContactField(dynamics)
    pairs = [place(dynamics, states, seed, sign) for seed in (1, 2)]
    mode = pairs[0][2]
    q, qd = np.array([x[0] for x in pairs]), np.array([x[1] for x in pairs])
    times = np.array([TIME, 0.3])
    segment = Segment((0,) * N, passage=Passage(mode))
    qdd, by_x = field.accelerate(times, q, qd, PIECE, segment)
    *_, loads, forces = field.solve(times, q, qd, PIECE, mode)
    for k in range(2):
        law = Law(dynamics.kernels.shape, mode, drive(times)[k])
        p, y = find(law, q[k], qd[k])
        assert qdd[k] == pytest.approx(y[:N], rel=1e-9, abs=1e-9)
        held = loads.normal[k, :, None] * dynamics.kernels.shape.normal(q[k]) + loads.friction[k]
        assert held == pytest.approx(law.forces(y, p), rel=1e-8, abs=1e-9)
        by_p, by_force = law.differentiate(y, p)
        assert by_x[k] == pytest.approx(by_p[:N, :SIZE], rel=1e-7, abs=1e-7)
        for point in mode.closed:
            assert forces[k, point] == pytest.approx(by_force[point, :, :SIZE], rel=1e-7, abs=1e-7)
        assert not forces[k, [x for x in range(POINTS) if x not in mode.closed]].any()


@pytest.mark.parametrize(
    ("states", "leaving"),
    [
        ((STICK, SLIP, OPEN), ()),
        ((OPEN, STICK, SLIP), ()),
        ((SLIP, SLIP, SLIP), ()),
        ((STICK, SLIP, OPEN), (0,)),
        ((STICK, SLIP, OPEN), (1,)),
        ((STICK, SLIP, SLIP), (0, 2)),
        ((SLIP, STICK, SLIP), (0, 1, 2)),
    ],
)
def test_impacts_are_differentiated(states: tuple[State, ...], leaving: tuple[int, ...]) -> None:
    """By the state at the start, through the state before the phase, and the impulses of the one before."""
    dynamics = make(6)
    shape, rng = dynamics.kernels.shape, np.random.default_rng(7)
    q, before = rng.standard_normal(NQ), 2 * rng.standard_normal(N)
    ratios, earlier = np.array([0.5, 0.3, 0.7]), np.array([1.1, 0.7, 0.4])
    restitution = np.array([0.6, 0.4, 0.2])
    R, given = rng.standard_normal((SIZE, SIZE)), rng.standard_normal((POINTS, SIZE))
    mode = Mode(states, np.zeros((POINTS, 3)), np.ones(POINTS), leaving=leaving)
    law = Law(shape, mode, restitution=restitution)
    p, y = find(law, q, before, ratios * earlier)
    forces, normals = law.forces(y, p), shape.normal(q)
    N_k = (forces * normals).sum(axis=1)
    loads = Loads(y[None, :N], N_k[None], (forces - N_k[:, None] * normals)[None], np.zeros(1))
    strike = Strike(q, before, mode, loads, restitution, ratios)
    field: Any = ContactField(dynamics)
    found, normal = field._strike(strike, R, given)
    by_p, by_force = law.differentiate(y, p)
    chain = np.concatenate((R, ratios[:, None] * given))
    assert found == pytest.approx(by_p[:N] @ chain, rel=1e-7, abs=1e-7)
    turn = shape.turn_normal(q)
    for k in range(POINTS):
        if k not in mode.closed:
            assert not normal[k].any()
            continue
        expected = normals[k] @ (by_force[k] @ chain) + forces[k] @ turn[k] @ R[:NQ]
        assert normal[k] == pytest.approx(expected, rel=1e-7, abs=1e-7)
    if leaving:
        return
    segment = Segment((0,) * N, passage=Passage(mode, strikes=(strike,)))
    once = field.strike(segment, np.zeros(SIZE))
    assert once[:NQ] == pytest.approx(np.eye(SIZE)[:NQ])
    assert once[NQ:] == pytest.approx(by_p[:N, :SIZE], rel=1e-7, abs=1e-7)
    twice = field.strike(Segment((0,) * N, passage=Passage(mode, strikes=(strike, strike))), np.zeros(SIZE))
    assert twice == pytest.approx(once @ once, rel=1e-7, abs=1e-7)
    assert field.strike(Segment((0,) * N, passage=Passage(mode)), np.zeros(SIZE)) is None


@pytest.mark.parametrize("states", MODES[1:])
def test_points_that_touch_restrain_places_and_velocities(states: tuple[State, ...]) -> None:
    dynamics = make(5)
    shape = dynamics.kernels.shape
    q, qd, mode = place(dynamics, states, 1)
    qd = qd + 0.1  # the rows are the ones of any velocity
    field: Any = ContactField(dynamics)
    law = Law(shape, mode)
    J, by_q, H, h_q = field.restrain(q[None], qd[None], Segment((0,) * N, passage=Passage(mode)))

    def list_rows(q: Array) -> Array:
        S, n = shape.read("slide", q), shape.normal(q)
        return np.concatenate([S[k] if law.sticks(k) else (n[k] @ S[k])[None] for k in mode.closed])

    assert pytest.approx(list_rows(q), abs=1e-12) == J
    assert by_q == pytest.approx(slope(lambda x: list_rows(x) @ qd, q), rel=1e-9, abs=1e-9)
    S, n = shape.read("slide", q), shape.normal(q)
    assert pytest.approx(np.array([n[k] @ S[k] for k in mode.closed]), abs=1e-12) == H
    assert h_q == pytest.approx(shape.turn("clearance", q)[mode.closed], abs=1e-12)


def test_guards_are_differentiated_by_state_and_time() -> None:
    """The distance, the normal force, the slip along its way, and what friction could hold besides."""
    dynamics = make(5)
    shape = dynamics.kernels.shape
    q, qd, mode = place(dynamics, (STICK, SLIP, OPEN), 1)
    field: Any = ContactField(dynamics)
    law = Law(shape, mode, drive(np.array([TIME]))[0])
    p, y = find(law, q, qd)
    _, by_force = law.differentiate(y, p)
    forces, n, dn = law.forces(y, p), shape.normal(q), shape.turn_normal(q)
    moved = replace(law, v=drive(np.array([TIME + 1j * TINY]))[0])
    by_time = -np.linalg.solve(slope(lambda x: law.miss(x, p), y), np.imag(moved.miss(y, p)) / TINY)
    force_rate = slope(lambda x: law.forces(x, p), y) @ by_time
    x = np.concatenate((q, qd))

    def turn(k: int) -> Array:
        return np.asarray(np.concatenate((forces[k] @ dn[k], np.zeros(N))))

    presses = [n[k] @ by_force[k, :, :SIZE] + turn(k) for k in (0, 1)]
    found, drift = field.slope(TIME, Guard(2, Bound.GAP), x, PIECE, mode)
    assert drift == 0
    assert found == pytest.approx(np.concatenate((shape.turn("clearance", q)[2], np.zeros(N))))
    found, drift = field.slope(TIME, Guard(1, Bound.SLIP), x, PIECE, mode)
    assert drift == 0
    way = mode.ways[1]
    assert found == pytest.approx(slope(lambda z: way @ (shape.read("slide", z[:NQ])[1] @ z[NQ:]), x), abs=1e-9)
    for k in (0, 1):
        found, drift = field.slope(TIME, Guard(k, Bound.PRESS), x, PIECE, mode)
        assert found == pytest.approx(presses[k], rel=1e-7, abs=1e-7)
        assert drift == pytest.approx(n[k] @ force_rate[k], rel=1e-6, abs=1e-6)
    N_0 = n[0] @ forces[0]
    T = forces[0] - N_0 * n[0]
    rub = T / np.linalg.norm(T)
    found, drift = field.slope(TIME, Guard(0, Bound.HOLD), x, PIECE, mode)
    along = by_force[0, :, :SIZE].copy()
    along[:, :NQ] -= N_0 * dn[0]
    assert found == pytest.approx(0.4 * presses[0] - rub @ along, rel=1e-7, abs=1e-7)
    rates = n[0] @ force_rate[0], rub @ force_rate[0]
    assert drift == pytest.approx(0.4 * rates[0] - rates[1], rel=1e-6, abs=1e-6)


def test_events_are_described_by_their_guards() -> None:
    """A gap has the speed after the impact, as it rebounds; other guards have none."""
    dynamics = make(5)
    q, qd, mode = place(dynamics, (STICK, SLIP, OPEN), 1)
    after = np.concatenate((q, qd + 1.0))
    guards = Guard(1, Bound.GAP), Guard(2, Bound.GAP), Guard(1, Bound.PRESS)
    old, new = (Segment((0,) * N, passage=Passage(mode, x)) for x in ((), guards))
    field: Any = ContactField(dynamics)
    assert (field.has_guards(old), field.has_guards(new)) == (False, True)
    assert field.list_crossings(TIME, after, after, PIECE, new, old) == []
    found = field.list_crossings(TIME, np.concatenate((q, qd)), after, PIECE, old, new)
    assert [(x.name, x.key) for x in found] == [("stop p1", 1), ("contact p2", 2), ("stop p1", 1)]
    shape = dynamics.kernels.shape
    speeds = np.abs(np.einsum("pi,pin,n->p", shape.normal(q), shape.read("slide", q), qd + 1))
    assert [found[0].rebound, found[1].rebound] == pytest.approx(speeds[1:])
    assert found[2].rebound is None
    expected = field.slope(TIME, guards[2], np.concatenate((q, qd)), PIECE, mode)
    assert found[2].slope == pytest.approx(expected[0])
    assert found[2].drift == pytest.approx(expected[1])


def test_normals_and_jacobians_are_differentiated_along_the_motion() -> None:
    """By differences of order 8 over 1e-3 of the fastest coordinate; nothing changes at rest."""
    dynamics = make(8)
    shape, rng = dynamics.kernels.shape, np.random.default_rng(1)
    q, rate = rng.standard_normal((2, NQ)), 40 * rng.standard_normal((2, NQ))
    rate[1] = 0
    field: Any = ContactField(dynamics)
    normal, slide = field.vary_along(q, rate)
    expected = slope(lambda x: shape.turn_normal(q[0] + x[0] * rate[0]), np.zeros(1))[..., 0]
    assert normal[0] == pytest.approx(expected, rel=1e-9, abs=1e-9)
    turned = slope(lambda x: shape.turn("slide", q[0] + x[0] * rate[0]), np.zeros(1))[..., 0]
    assert slide[0] == pytest.approx(turned, rel=1e-9, abs=1e-9)
    assert not normal[1].any()
    assert not slide[1].any()


@pytest.mark.parametrize(("part", "is_one"), [(0.9e-10, False), (1.1e-10, True)])
def test_slipping_points_share_their_load_in_one_way(part: float, is_one: bool) -> None:
    """Without friction, or where none slips, it does not matter."""
    for friction, states in ((0.4, (SLIP, SLIP, OPEN)), (0.0, (SLIP, SLIP, OPEN)), (0.4, (STICK, STICK, OPEN))):
        field: Any = ContactField(make(5, (friction, friction, 0.0)))
        J = np.diag([1.0, part])[None]
        rows: Any = type("Rows", (), {"J": J, "G": np.eye(2)[None], "first": {0: 0, 1: 1}})
        mode = Mode(states, np.zeros((3, 3)), np.ones(3))
        if friction and SLIP in states and not is_one:
            with pytest.raises(SlopeError, match="points that slip share their load in several ways"):
                field.check(np.eye(2)[None], rows, mode)
        else:
            field.check(np.eye(2)[None], rows, mode)
        rows.first = {}
        field.check(np.eye(2)[None], rows, mode)


@pytest.mark.parametrize(("part", "is_one"), [(0.9e-10, False), (1.1e-10, True)])
def test_guards_of_forces_need_determined_ones(part: float, is_one: bool) -> None:
    """Rows that are 0, of directions in which nothing moves, do not count: they are 1e-12 of the largest or less."""
    field: Any = ContactField(make(5, (0.4, 0.4, 0.0)))
    field.dynamics = type("Unit", (), {"mass_matrix": lambda *_: np.eye(2)[None]})
    mode = Mode((STICK, SLIP, OPEN), np.zeros((3, 3)), np.ones(3))
    slide = np.zeros((1, 3, 3, 2))
    slide[0, 0, 0], slide[0, 1, 2] = [1.0, 0.0], [0.0, np.sqrt(part)]
    slide[0, 0, 1] = [0.0, 0.9e-12]
    none = np.zeros((1, 3))
    normal = np.tile([0.0, 0.0, 1.0], (1, 3, 1))
    touch = Touch(none, normal, slide, np.zeros((1, 3, 3)), none, np.zeros((1, 3, 3)), none)
    given = np.zeros((1, 2)), np.zeros((1, 2)), np.zeros((1, 0)), touch, mode
    if is_one:
        field._check_alone(*given)
        slide[0, 0, 1] = [0.0, 1.1e-12]
    with pytest.raises(SlopeError, match="points share their load in several ways"):
        field._check_alone(*given)


@pytest.mark.parametrize(("slip", "is_known"), [(0.9e-12, False), (1.1e-12, True), (0.0, False)])
def test_a_slip_that_begins_has_many_directions(slip: float, is_known: bool) -> None:
    """Across it something moves, by more than 1e-12 of the velocity's derivatives; on a straight way nothing does."""
    field: Any = ContactField(make(5))
    normal, ways = np.tile([0.0, 0.0, 1.0], (1, 3, 1)), np.tile([1.0, 0.0, 0.0], (3, 1))
    mode = Mode((SLIP, OPEN, OPEN), ways, np.ones(3))
    none = np.zeros((1, 3))
    slopes: Any = type("Slopes", (), {"normal": np.zeros((1, 3, 3, NQ)), "slide": np.zeros((1, 3, 3, N, NQ))})
    for across, is_straight in ((0.9e-12, True), (1.1e-12, False), (-1.1e-12, False)):
        slide, velocity = np.zeros((1, 3, 3, N)), np.zeros((1, 3, 3))
        slide[0, 0, 0, 0], slide[0, 0, 1, 1] = 1.0, across
        velocity[0, 0], velocity[0, 1, 2] = [slip, 0.0, 0.0], 1.0
        touch = Touch(none, normal, slide, velocity, none, velocity, none)
        if is_straight or is_known:
            found = field.turn(touch, slopes, np.zeros((1, N)), mode, 0)
            assert found[0, 1, NQ + 1] == (0.0 if is_straight else pytest.approx(across / slip))
            assert np.count_nonzero(found) == (0 if is_straight else 1)
        else:
            with pytest.raises(SlopeError, match="contact p0 begins to slip, in one of many directions"):
                field.turn(touch, slopes, np.zeros((1, N)), mode, 0)
