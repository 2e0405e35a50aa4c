"""Derivatives through stops, dry friction and loops: the implicit function theorem on their laws, by complex steps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen.manifest import Friction, Stops
from mbsrun.simulation.integration.joints import Joints
from mbsrun.simulation.motion import FORCE, PLACE, SPEED, Guard, Jump, Mode, Segment
from mbsrun.simulation.variation import JointField, SlopeError, border, weigh
from tests.mbsrun.simulation import curved
from tests.mbsrun.simulation.curved import NQ, PIECE, TINY, N, Shape, drive, slope

Array = NDArray[Any]
SIZE = NQ + N
LOOPS = 2
TIME = 0.7
PLACES = (2, 4, 5, 0, 1, 3)  # of the joints' coordinates, among seven
TORQUE, STATIC, STRIBECK = (
    (0.3, 0.5, 0.2, 0.0, 0.0, 0.4),
    (0.3, 0.9, 0.6, 0.0, 0.0, 0.4),
    (0.0, 0.8, 0.5, 0.0, 0.0, 0.0),
)


def measure_course(t: Array) -> Array:
    """Return the acceleration of the driven joint."""
    return np.asarray(np.cos(2 * t) + t)


@dataclass(frozen=True, eq=False)
class Kernels:
    """The kernels of loops: hd = J(q) qd, hdd = J(q) qdd + gamma(q, qd), and gaps that have nothing to do with them."""

    shape: Shape
    owners: tuple[int, ...]
    driven: tuple[int, ...]

    @property
    def manifest(self) -> Any:
        """Return the joints."""
        names = [f"j{k}" for k in range(N)]
        return SimpleNamespace(
            coordinates=[
                SimpleNamespace(
                    name=name,
                    stops=Stops(lower=-1.0, upper=None if k else 2.0, restitution=0.5) if k < 2 else None,
                    friction=Friction(torque=TORQUE[k], static=STATIC[k], stribeck=STRIBECK[k] or None, one_way=0)
                    if STATIC[k]
                    else None,
                )
                for k, name in enumerate(names)
            ],
            positions=[names[PLACES.index(k)] if k in PLACES else "other" for k in range(NQ)],
            inputs=("a", "b"),
            owners=self.owners,
            driven=self.driven,
        )

    def pull(self, q: Array) -> Array:
        """Return J, (loops, n)."""
        return np.asarray(self.shape.read("slide", q)[0, : len(self.owners)])

    def gamma(self, q: Array, qd: Array) -> Array:
        """Return the accelerations of loops without qdd."""
        return np.asarray(self.shape.read("direction", q)[0, : len(self.owners)] * (qd @ qd))

    def __call__(self, name: str, q: Array, **given: Array) -> dict[str, Array]:
        if name == "jac_loop_accelerations":
            states = list(zip(q, given["qd"], given["qdd"], strict=True))
            by_q = [slope(lambda x, y=y: self.pull(x) @ y[2] + self.gamma(x, y[1]), y[0]) for y in states]  # type: ignore[misc]
            by_qd = [slope(lambda x, y=y: self.gamma(y[0], x), y[1]) for y in states]  # type: ignore[misc]
            return {"jac_hdd_q": np.array(by_q), "jac_hdd_qd": np.array(by_qd)}
        if name == "jac_loop_rates":
            pairs = zip(q, given["qd"], strict=True)
            return {"jac_hd_q": np.array([slope(lambda x, w=w: self.pull(x) @ w, y) for y, w in pairs])}  # type: ignore[misc]
        if name == "jac_loop_forces":
            pairs = zip(q, given["lam"], strict=True)
            return {"jac_Q_q": np.array([slope(lambda x, w=w: self.pull(x).T @ w, y) for y, w in pairs])}  # type: ignore[misc]
        return {"jac_gap_q": np.array([self.shape.turn("clearance", x)[: len(self.owners)] for x in q])}


@dataclass(frozen=True)
class Linked(curved.Curved):
    """The same mechanism with loops, whose forces are part of the residual, and a driven joint."""

    def residual(self, q: Array, qd: Array, qdd: Array, v: Array, lam: Array | None = None) -> Array:
        """Return residuals."""
        found = super().residual(q, qd, qdd, v)
        if lam is None:
            return found
        return np.asarray(found - [self.kernels.pull(x).T @ w for x, w in zip(q, lam, strict=True)])

    def stiffnesses(self, q: Array, qd: Array, qdd: Array, v: Array, lam: Array | None = None) -> tuple[Array, ...]:
        """Differentiate residuals."""
        K, C, M = super().stiffnesses(q, qd, qdd, v)
        return (K if lam is None else K - self.kernels("jac_loop_forces", q=q, lam=lam)["jac_Q_q"]), C, M

    @property
    def course(self) -> Any:
        """Return the motion of the driven joint."""
        return SimpleNamespace(states=lambda t: (None, None, measure_course(t)[:, None]))


def make(seed: int, loops: int = LOOPS, driven: tuple[int, ...] = (4,)) -> Any:
    """Draw a mechanism, and make its field."""
    kernels: Any = Kernels(Shape(np.random.default_rng(seed)), tuple(range(loops)), driven)
    field: Any = JointField.__new__(JointField)
    field.dynamics = Linked(kernels)
    field.places, field.size = NQ, SIZE
    field.joints = Joints.of(kernels.manifest)
    field.closure = SimpleNamespace(
        count=loops,
        jacobian=lambda q: np.array([kernels.pull(x) for x in q]).reshape(len(q), loops, N),
        bias=lambda q, qd: np.array([kernels.gamma(*x) for x in zip(q, qd, strict=True)]).reshape(len(q), loops),
    )
    return field


def rub(modes: tuple[int, ...], qd: Array) -> Array:
    """Return the friction of sliding joints, along their ways."""
    found = []
    for k, mode in enumerate(modes):
        stribeck = np.exp(-((qd[k] / STRIBECK[k]) ** 2)) if STRIBECK[k] else 0.0
        found.append((mode if abs(mode) == 1 else 0) * (TORQUE[k] + (STATIC[k] - TORQUE[k]) * stribeck))
    return np.array(found)


def miss(field: Any, segment: Segment, held: list[int], y: Array, x: Array, t: Any) -> Array:
    """Return what is missing to the equations: y are accelerations, forces of loops, and of held joints."""
    kernels, loops = field.dynamics.kernels, field.closure.count
    q, qd, a, lam = x[:NQ], x[NQ:], y[:N], y[N : N + loops]
    v = drive(np.array([t]))[0]
    top = kernels.shape.residual(q, qd, a, v) - kernels.pull(q).T @ lam + rub(segment.modes, qd)
    top = top - np.eye(N)[:, held] @ y[N + loops :]
    if segment.locking is not None:
        constant = [k for k, mode in enumerate(segment.modes) if abs(mode) > 1 and k not in segment.locking]
        top = top - np.eye(N)[:, constant] @ np.array(segment.forces)[constant]
    goal = [measure_course(t) if k in field.joints.driven else 0.0 for k in held]
    return np.concatenate((top, kernels.pull(q) @ a + kernels.gamma(q, qd), a[held] - np.array(goal)))


STICKS, LOWER, UPPER = int(Mode.STICKS), int(Mode.LOWER), int(Mode.UPPER)
SEGMENTS = [
    (Segment((0, 1, -1, 0, 0, 1)), [4]),
    (Segment((0, -1, STICKS, 0, 0, LOWER)), [2, 4, 5]),
    (Segment((UPPER, 0, 1, 0, 0, 0)), [0, 4]),
    (Segment((LOWER, 1, STICKS, 0, 0, 0), locking=(2,), forces=(0.7, 0.0, 9.0, 0.0, 9.0, 9.0)), [2, 4]),
]


@pytest.mark.parametrize(("segment", "held"), SEGMENTS)
@pytest.mark.parametrize("loops", [0, LOOPS])
def test_accelerations_and_forces_are_differentiated(segment: Segment, held: list[int], loops: int) -> None:
    field, rng = make(3, loops), np.random.default_rng(4)
    x, t = rng.standard_normal((2, SIZE)), np.array([TIME, 1.1])
    qdd, by_x, forces, slopes = field.solve(t, x[:, :NQ], x[:, NQ:], PIECE, segment)
    accelerations = field.accelerate(t, x[:, :NQ], x[:, NQ:], PIECE, segment)
    assert accelerations[0] == pytest.approx(qdd)
    assert accelerations[1] == pytest.approx(by_x)
    for k in range(2):
        start = np.zeros(N + loops + len(held))
        zero = miss(field, segment, held, start, x[k], t[k])
        by_y = slope(lambda y, k=k: miss(field, segment, held, y, x[k], t[k]), start)  # type: ignore[misc]
        y = -np.linalg.solve(by_y, zero)
        by_p = -np.linalg.solve(by_y, slope(lambda z, k=k, y=y: miss(field, segment, held, y, z, t[k]), x[k]))  # type: ignore[misc]
        assert qdd[k] == pytest.approx(y[:N], rel=1e-9, abs=1e-9)
        assert forces[k] == pytest.approx(y[N + loops :], rel=1e-9, abs=1e-9)
        assert by_x[k] == pytest.approx(by_p[:N], rel=1e-8, abs=1e-8)
        assert slopes[k] == pytest.approx(by_p[N + loops :], rel=1e-8, abs=1e-8)


def test_guards_are_differentiated_by_state_and_time() -> None:
    segment, held = SEGMENTS[1]
    field, x = make(3), np.random.default_rng(4).standard_normal(SIZE)
    for kind, joint, place in ((PLACE, 1, PLACES[1]), (SPEED, 2, NQ + 2)):
        guard = Guard(kind, joint, PLACES[joint], 1.0, 0.0)
        found, drift = field.slope(TIME, guard, x, PIECE, segment)
        assert found.tolist() == np.eye(SIZE)[place].tolist()
        assert drift == 0
    start = np.zeros(N + LOOPS + 3)
    by_y = slope(lambda y: miss(field, segment, held, y, x, TIME), start)
    y = -np.linalg.solve(by_y, miss(field, segment, held, start, x, TIME))
    by_p = -np.linalg.solve(by_y, slope(lambda z: miss(field, segment, held, y, z, TIME), x))
    by_t = -np.linalg.solve(by_y, np.imag(miss(field, segment, held, y, x, TIME + 1j * TINY)) / TINY)
    for joint, row in ((2, 0), (5, 2)):
        found, drift = field.slope(TIME, Guard(FORCE, joint, PLACES[joint], 1.0, 0.0), x, PIECE, segment)
        assert found == pytest.approx(by_p[N + LOOPS + row], rel=1e-8, abs=1e-8)
        assert drift == pytest.approx(by_t[N + LOOPS + row], rel=1e-6, abs=1e-7)
    with pytest.raises(SlopeError, match="joints share their load anew"):
        field.slope(TIME, Guard(FORCE, 1, PLACES[1], 1.0, 0.0), x, PIECE, segment)


def test_events_are_described_by_their_guards() -> None:
    """A stop has the speed after the impact, as it rebounds; other guards have none."""
    segment, _ = SEGMENTS[1]
    field, rng = make(3), np.random.default_rng(4)
    before, after = rng.standard_normal((2, SIZE))
    guards = Guard(PLACE, 1, PLACES[1], 1.0, 0.0), Guard(FORCE, 2, PLACES[2], 1.0, 0.0)
    new = replace(segment, guards=guards)
    assert (field.has_guards(segment), field.has_guards(new)) == (False, True)
    found = field.list_crossings(TIME, before, after, PIECE, segment, new)
    assert [(x.name, x.key) for x in found] == [("joint j1", 1), ("joint j2", 2)]
    assert (found[0].rebound, found[1].rebound) == (abs(after[NQ + 1]), None)
    expected = field.slope(TIME, guards[1], before, PIECE, segment)
    assert found[1].slope == pytest.approx(expected[0])
    assert (found[0].drift, found[1].drift) == (0.0, pytest.approx(expected[1]))


@pytest.mark.parametrize(("segment", "held"), SEGMENTS)
@pytest.mark.parametrize("loops", [0, LOOPS])
def test_modes_restrain_places_and_velocities(segment: Segment, held: list[int], loops: int) -> None:
    """Joints at rest and driven ones keep their velocities; loops and driven joints keep their places."""
    field, rng = make(3, loops), np.random.default_rng(4)
    q, qd = rng.standard_normal(NQ), rng.standard_normal(N)
    J, by_q, H, h_q = field.restrain(q[None], qd[None], segment)
    still = sorted({*held, *(k for k, mode in enumerate(segment.modes) if abs(mode) > 1)})
    pull = field.dynamics.kernels.pull
    assert pytest.approx(np.concatenate((pull(q), np.eye(N)[still]))) == J
    assert by_q[:loops] == pytest.approx(slope(lambda x: pull(x) @ qd, q).reshape(loops, NQ))
    assert not by_q[loops:].any()
    assert pytest.approx(np.concatenate((pull(q), np.eye(N)[[4]]))) == H
    assert h_q[:loops] == pytest.approx(field.dynamics.kernels.shape.turn("clearance", q)[:loops])
    assert h_q[loops:].tolist() == [np.eye(NQ)[PLACES[4]].tolist()]


@pytest.mark.parametrize(("loops", "driven"), [(0, ()), (0, (4,)), (LOOPS, ()), (LOOPS, (4,))])
def test_impacts_are_differentiated(loops: int, driven: tuple[int, ...]) -> None:
    """M (after - before) are impulses of loops, stops and drives; joints that hit rebound, and driven ones go on."""
    field, rng = make(3, loops, driven), np.random.default_rng(4)
    q, before = rng.standard_normal(NQ), rng.standard_normal(N)
    kernels, hit, e = field.dynamics.kernels, (1, 5), np.array([0.5, 0.3])

    def fail(y: Array, x: Array) -> Array:
        q, before, after, P = x[:NQ], x[NQ:], y[:N], y[N:]
        rows = np.concatenate((kernels.pull(q), np.eye(N)[[*hit, *driven]]))
        top = kernels.shape.mass(q) @ (after - before) - rows.T @ P
        return np.concatenate(
            (top, kernels.pull(q) @ after, after[list(hit)] + e * before[list(hit)], (after - before)[list(driven)])
        )

    x, start = np.concatenate((q, before)), np.zeros(N + loops + 2 + len(driven))
    by_y = slope(lambda y: fail(y, x), start)
    y = -np.linalg.solve(by_y, fail(start, x))
    by_x = -np.linalg.solve(by_y, slope(lambda z: fail(y, z), x))[:N]
    jump = Jump(before, y[:N], hit, tuple(e))
    found = field._strike(q, jump)
    assert found[:NQ].tolist() == np.eye(SIZE)[:NQ].tolist()
    assert found[NQ:] == pytest.approx(by_x, rel=1e-8, abs=1e-8)
    assert field.strike(Segment((0,) * N), x) is None
    assert field.strike(Segment((0,) * N, jumps=(jump,)), x) == pytest.approx(found)
    second = Jump(y[:N], before, (2,), (0.1,))
    both = field.strike(Segment((0,) * N, jumps=(jump, second)), x)
    assert both == pytest.approx(field._strike(q, second) @ found)


@pytest.mark.parametrize("owners", [(), (0, 1)])
def test_the_inertia_of_a_change_is_differentiated(owners: tuple[int, ...]) -> None:
    """By the coordinates; what acts without the change has no part in it."""
    rng = np.random.default_rng(5)
    field = make(6, len(owners))
    q, change = rng.standard_normal(NQ), rng.standard_normal(N)
    by_q, M = weigh(field.dynamics, q[None], change[None])
    shape = field.dynamics.kernels.shape
    assert by_q == pytest.approx(slope(lambda x: shape.mass(x) @ change, q), rel=1e-9, abs=1e-9)
    assert pytest.approx(shape.mass(q)) == M


def test_rates_of_the_state_are_differentiated() -> None:
    """E(q) qd above the accelerations."""
    segment, _ = SEGMENTS[0]
    field, rng = make(3), np.random.default_rng(4)
    x, t = rng.standard_normal((2, SIZE)), np.array([TIME, 1.1])
    rates, slopes = field.at(t, x, PIECE, segment)
    read = field.dynamics.kernels.shape.read
    qdd, by_x = field.accelerate(t, x[:, :NQ], x[:, NQ:], PIECE, segment)
    for k in range(2):
        assert rates[k] == pytest.approx(np.concatenate((read("rate", x[k, :NQ]) @ x[k, NQ:], qdd[k])))
        upper = slope(lambda z: read("rate", z[:NQ]) @ z[NQ:], x[k])
        assert slopes[k] == pytest.approx(np.concatenate((upper, by_x[k])), rel=1e-9, abs=1e-9)


def test_a_change_of_the_start_is_followed_by_the_least_one_that_keeps_the_equations() -> None:
    """Places first, along the velocities that the rows of places give; then velocities, at the new places."""
    segment, _ = SEGMENTS[1]
    field, rng = make(3), np.random.default_rng(4)
    x = rng.standard_normal(SIZE)
    found = field.project(x, segment)
    J, by_q, H, h_q = field.restrain(x[None, :NQ], x[None, NQ:], segment)
    E = field.dynamics.kernels.shape.read("rate", x[:NQ])
    for row in np.eye(SIZE):
        change = found @ row
        speeds = -np.linalg.lstsq(H, h_q @ row[:NQ], rcond=None)[0]
        assert change[:NQ] == pytest.approx(row[:NQ] + E @ speeds, abs=1e-9)
        assert J @ change[NQ:] + by_q @ change[:NQ] == pytest.approx(np.zeros(len(J)), abs=1e-9)
        least = np.linalg.lstsq(J, -(by_q @ change[:NQ] + J @ row[NQ:]), rcond=None)[0]
        assert change[NQ:] == pytest.approx(row[NQ:] + least, abs=1e-9)
    rows = np.zeros((2, N)), np.ones((2, NQ)), np.diag([1.0, 0.9e-10, 0, 0, 0, 0])[:2], np.eye(2, NQ)
    field.restrain = lambda *_: rows
    far = field.project(x, segment)
    assert far[NQ:] == pytest.approx(np.eye(SIZE)[NQ:])
    assert np.abs(far[:NQ, 1] - np.eye(NQ)[1]).max() == 0
    assert far[:NQ, 0] == pytest.approx(np.eye(NQ)[0] - E[:, 0])


def test_bordered_systems_have_the_least_multipliers() -> None:
    """Singular values of J M^-1 G up to 1e-10 of the largest are 0."""
    M, top = 2 * np.eye(2)[None], np.array([[[2.0], [4.0]]])
    none = np.zeros((1, 2, 0)), np.zeros((1, 0, 2))
    a, lam = border(M, *none, top, np.zeros((1, 0, 1)))
    assert (a[0, :, 0].tolist(), lam.shape) == ([1.0, 2.0], (1, 0, 1))
    twice = np.array([[[1.0, 0.0], [1.0, 0.0]]])
    a, lam = border(M, twice.swapaxes(1, 2), twice, top, np.full((1, 2, 1), 3.0))
    assert a[0, :, 0] == pytest.approx([3.0, 2.0])
    assert lam[0, :, 0] == pytest.approx([2.0, 2.0])
    for part, second in ((0.9e-10, 2.0), (1.1e-10, 3.0)):
        G = np.array([[[1.0, 0.0], [0.0, part]]])
        a, _ = border(M, G, np.eye(2)[None], top, np.full((1, 2, 1), 3.0))
        assert a[0, :, 0] == pytest.approx([3.0, second])
