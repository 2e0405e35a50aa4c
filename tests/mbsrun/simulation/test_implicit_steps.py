"""Implicit steps by their equations: Newton's steps solve the linearised ones exactly, by complex steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsrun.kernel import KernelError
from mbsrun.limits import Allowance, LimitError, Limits
from mbsrun.ocp.ground import schemes
from mbsrun.quaternions import multiply
from mbsrun.simulation.drive import DriveError, Piece
from mbsrun.simulation.dynamics import SingularError
from mbsrun.simulation.integration import implicit
from mbsrun.simulation.integration.groups import find_group
from mbsrun.simulation.integration.implicit import (
    Places,
    Scheme,
    State,
    extrapolate,
    find_start,
    integrate,
    iterate,
    make_alpha,
    make_collocation,
    make_symplectic,
    scale_changes,
    scale_velocities,
)
from mbsrun.simulation.motion import HaltError, Settings
from tests.mbsrun.simulation import curved
from tests.mbsrun.simulation.curved import NQ, PIECE, N, Shape, drive, slope

Array = NDArray[Any]

H, TIME = 0.2, 0.6


def turn(q: Array, w: Array) -> Array:
    """Return the rates of three coordinates that are integrals of velocities, and of a quaternion."""
    return np.concatenate((w[:3], multiply(q[3:], np.append(w[3:], 0.0 * w[0])) / 2))


@dataclass(frozen=True)
class Mechanism(curved.Curved):
    """Three slides and a ball, or six slides alone, with the inertia and the forces of `curved`."""

    has_ball: bool = True
    effort: Any = field(default_factory=lambda: SimpleNamespace(iterations=0, steps=0))

    def pad(self, q: Array) -> Array:
        """Return coordinates that polynomials read."""
        return q if self.has_ball else np.append(q, 0.5)

    def rate(self, q: Array, w: Array) -> Array:
        """Return the rates at one state."""
        return turn(q, w) if self.has_ball else w

    def rates(self, q: Array, qd: Array) -> Array:
        """Return the rates."""
        if q.ndim == 1:
            return self.rate(q, qd)
        return np.array([self.rate(*x) for x in zip(q, qd, strict=True)])

    def rate_slopes(self, q: Array, qd: Array) -> tuple[Array, Array]:
        """Differentiate the rates."""
        if q.ndim == 1:
            a, b = self.rate_slopes(q[None], qd[None])
            return a[0], b[0]
        pairs = list(zip(q, qd, strict=True))
        by_q = [slope(lambda x, w=w: self.rate(x, w), y) for y, w in pairs]  # type: ignore[misc]
        return np.array(by_q), np.array([slope(lambda x, y=y: self.rate(y, x), w) for y, w in pairs])  # type: ignore[misc]

    def residual(self, q: Array, qd: Array, qdd: Array, v: Array, _lam: Array | None = None) -> Array:
        """Return residuals, of one state or several."""
        if q.ndim == 1:
            return np.asarray(self.kernels.shape.residual(self.pad(q), qd, qdd, v))
        return np.array([self.residual(*x) for x in zip(q, qd, qdd, v, strict=True)])

    def stiffnesses(self, q: Array, qd: Array, qdd: Array, v: Array, _lam: Array | None = None) -> tuple[Array, ...]:
        """Differentiate residuals."""
        if q.ndim == 1:
            return (
                slope(lambda x: self.residual(x, qd, qdd, v), q),
                slope(lambda x: self.residual(q, x, qdd, v), qd),
                slope(lambda x: self.residual(q, qd, x, v), qdd),
            )
        found = [self.stiffnesses(*x) for x in zip(q, qd, qdd, v, strict=True)]
        return tuple(np.array(x) for x in zip(*found, strict=True))

    def input_slopes(self, q: Array, _qd: Array, _qdd: Array, _v: Array, _lam: Array | None = None) -> Array:
        """Differentiate residuals by the inputs."""
        return np.array([-self.kernels.shape.inputs] * len(q))

    def find_pivot(self, _M: Array) -> str:
        """Name a joint."""
        return "j3"


@dataclass(frozen=True)
class Kernels:
    """The kernels that groups of coordinates read."""

    shape: Shape
    has_ball: bool

    @property
    def manifest(self) -> Any:
        """Return the joints."""
        names = tuple(f"j{k}" for k in range(N))
        positions = (*names[:3], "b.qx", "b.qy", "b.qz", "b.qw") if self.has_ball else names
        return SimpleNamespace(
            quaternions=(3,) if self.has_ball else (),
            positions=positions,
            coordinates=[SimpleNamespace(name=x) for x in names],
            configuration=self.has_ball,
            inputs=("a", "b"),
            owners=(),
            driven=(),
        )

    def __call__(self, _: str, q: Array, qd: Array) -> dict[str, Array]:
        return {"jac_rate_q": slope(lambda x: turn(x, qd), q)}


def make(has_ball: bool, seed: int = 2) -> Any:
    """Draw a mechanism."""
    kernels: Any = Kernels(Shape(np.random.default_rng(seed)), has_ball)
    return Mechanism(kernels, places=NQ if has_ball else N, has_ball=has_ball)


def follow_state(t: Array, q: Array, qd: Array) -> Array:
    """Return inputs that follow the state; linear in it, so that differences are exact to rounding."""
    return np.stack((t + 0.3 * q[:, 0] - qd[:, 1], 2 * qd[:, 4] + q[:, 2] * t), axis=1)


FOLLOWED = Piece(0.0, 2.0, drive, False, follow_state)


def start(dynamics: Any, seed: int = 3) -> State:
    """Draw the end of a step."""
    rng = np.random.default_rng(seed)
    q, qd, qdd = rng.standard_normal(dynamics.places), rng.standard_normal(N), rng.standard_normal(N)
    if dynamics.has_ball:
        q[3:] /= np.linalg.norm(q[3:])
    return State(q, qd, qdd, q[None], qd[None])


class Capture:
    """In place of Newton's method: keeps its functions, and returns given numbers."""

    def __init__(self, result: Array) -> None:
        self.result = result
        self.correct: Callable[[Array], Array] = lambda z: z
        self.guess, self.scale = np.zeros(0), np.zeros(0)

    def __call__(self, _: Any, correct: Callable[[Array], Array], guess: Array, scale: Array) -> Array:
        self.correct, self.guess, self.scale = correct, guess, scale
        return self.result


def expect_newton(correct: Callable[[Array], Array], miss: Callable[[Array], Array], z: Array, tol: float) -> None:
    """Compare a step with the one that the derivative of the equations gives."""
    flat = z.ravel()
    by_z = slope(lambda x: miss(x.reshape(z.shape)).ravel(), flat)
    expected = -np.linalg.solve(by_z, miss(z).ravel())
    assert correct(z).ravel() == pytest.approx(expected, rel=tol, abs=tol)


@pytest.mark.parametrize("piece", [PIECE, FOLLOWED])
@pytest.mark.parametrize("rho", [0.0, 0.6, 1.0])
def test_generalised_alpha_solves_its_equations(monkeypatch: pytest.MonkeyPatch, piece: Piece, rho: float) -> None:
    """Arnold, Bruls (2007), equations (5) to (9); the method's own acceleration goes from step to step."""
    dynamics, rng = make(False), np.random.default_rng(4)
    scheme, state = make_alpha(dynamics, piece, Settings(2.0, rho=rho)), start(dynamics)
    alpha_m, alpha_f = (2 * rho - 1) / (rho + 1), rho / (rho + 1)
    gamma = 1 / 2 + alpha_f - alpha_m
    beta = (gamma + 1 / 2) ** 2 / 4
    a = state.qdd
    assert scheme.points is not None
    assert scheme.weights is not None
    assert (scheme.points.tolist(), scheme.weights.tolist()) == ([0.0, 1.0], [0.5, 0.5])
    for time in (TIME, TIME + H):
        z = rng.standard_normal(N)
        newton = Capture(z)
        monkeypatch.setattr(implicit, "iterate", newton)
        after = scheme.step(state, time, H)

        def advance(z: Array, state: State = state, a: Array = a) -> tuple[Array, Array, Array]:
            new = ((1 - alpha_f) * z + alpha_f * state.qdd - alpha_m * a) / (1 - alpha_m)
            q = state.q + H * state.qd + H**2 * ((0.5 - beta) * a + beta * new)
            return q, state.qd + H * ((1 - gamma) * a + gamma * new), new

        def miss(z: Array, time: float = time, advance: Any = advance) -> Array:
            q, qd, _ = advance(z)
            return np.asarray(dynamics.residual(q, qd, z, piece.at(time + H, q, qd)))

        expect_newton(newton.correct, miss, z, 1e-6 if piece.law else 1e-9)
        assert newton.guess is state.qdd
        assert newton.scale == pytest.approx(scale_changes(state, H))
        q, qd, a = advance(z)
        assert after.q == pytest.approx(q, abs=1e-13)
        assert after.qd == pytest.approx(qd, abs=1e-13)
        assert after.qdd is z
        assert after.stage_q.tolist() == [state.q.tolist(), after.q.tolist()]
        assert after.stage_qd.tolist() == [state.qd.tolist(), after.qd.tolist()]
        state = after


def test_generalised_alpha_moves_along_the_group() -> None:
    """By the mean velocity of the step; derivatives are differences."""
    dynamics = make(True)
    group, state, rho = find_group(dynamics.kernels), start(dynamics), 0.5
    alpha_m, alpha_f = 0.0, 1 / 3
    gamma = 1 / 2 + alpha_f - alpha_m
    beta = (gamma + 1 / 2) ** 2 / 4
    scheme, z = make_alpha(dynamics, PIECE, Settings(2.0, rho=rho)), np.random.default_rng(4).standard_normal(N)
    newton = Capture(z)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(implicit, "iterate", newton)
        after = scheme.step(state, TIME, H)

    def advance(z: Array) -> tuple[Array, Array]:
        new = (1 - alpha_f) * z + alpha_f * state.qdd
        way = H * (state.qd + H * ((0.5 - beta) * state.qdd + beta * new))
        return group.move(state.q, way), state.qd + H * ((1 - gamma) * state.qdd + gamma * new)

    def miss(z: Array) -> Array:
        q, qd = advance(z)
        return np.asarray(dynamics.residual(q, qd, z, drive(np.array([TIME + H]))[0]))

    by_z = np.stack([(miss(z + 1e-6 * e) - miss(z - 1e-6 * e)) / 2e-6 for e in np.eye(N)], axis=1)
    assert newton.correct(z) == pytest.approx(-np.linalg.solve(by_z, miss(z)), rel=1e-6, abs=1e-7)
    assert after.q == pytest.approx(advance(z)[0])
    assert after.qd == pytest.approx(advance(z)[1])


def place(dynamics: Any, A: Array, q: Array, V: Array) -> Array:
    """Solve Q = q + h A rates(Q, V), which is linear in quaternions, and an integral in other coordinates."""
    s = len(V)
    Q = np.zeros((s, q.size), dtype=V.dtype) + q + H * A @ np.array([dynamics.rate(q, w) for w in V])
    if dynamics.has_ball:
        turns = [slope_of_turn(w) for w in V]
        whole = np.eye(4 * s, dtype=V.dtype) - H * np.block([[A[i, j] * turns[j] for j in range(s)] for i in range(s)])
        Q[:, 3:] = np.linalg.solve(whole, np.tile(q[3:], s)).reshape(s, 4)
    return np.asarray(Q)


def slope_of_turn(w: Array) -> Array:
    """Return the matrix of a quaternion's rates at a velocity."""
    rest = np.zeros(3)
    return np.stack([turn(np.concatenate((rest, e)), w)[3:] for e in np.eye(4)], axis=1)


@pytest.mark.parametrize("piece", [PIECE, FOLLOWED])
@pytest.mark.parametrize("has_ball", [False, True])
@pytest.mark.parametrize(("family", "stages"), [(schemes.Family.RADAU, 2), (schemes.Family.LEGENDRE, 3)])
def test_collocation_solves_its_equations(
    monkeypatch: pytest.MonkeyPatch, family: schemes.Family, stages: int, has_ball: bool, piece: Piece
) -> None:
    """The residual is 0 at the stages, whose velocities and coordinates are integrals of the unknowns."""
    dynamics, rng = make(has_ball), np.random.default_rng(4)
    made = make_collocation(family, dynamics, piece, Settings(2.0, stages=stages))
    scheme, state, z = schemes.build(family, stages), start(dynamics), rng.standard_normal((stages, N))
    A, b, c = scheme.integration, scheme.weights, scheme.points
    newton = Capture(z)
    monkeypatch.setattr(implicit, "iterate", newton)
    after = made.step(state, TIME, H)

    def miss(z: Array) -> Array:
        V = state.qd + H * A @ z
        Q = place(dynamics, A, state.q, V)
        found = [dynamics.residual(*x, piece.at(TIME + H * t, *x[:2])) for *x, t in zip(Q, V, z, c, strict=True)]
        return np.array(found)

    expect_newton(newton.correct, miss, z, 1e-6 if piece.law else 1e-9)
    V = state.qd + H * A @ z
    Q = place(dynamics, A, state.q, V)
    assert newton.guess.tolist() == [state.qdd.tolist()] * stages
    assert newton.scale == pytest.approx(scale_changes(state, H))
    assert after.stage_qd == pytest.approx(V, abs=1e-13)
    assert after.stage_q == pytest.approx(Q, abs=1e-12)
    assert after.qd == pytest.approx(state.qd + H * b @ z, abs=1e-13)
    assert after.q == pytest.approx(state.q + H * b @ dynamics.rates(Q, V), abs=1e-12)
    assert after.qdd == pytest.approx(extrapolate(c) @ z)
    assert made.points is c
    assert made.weights is b


@pytest.mark.parametrize("has_ball", [False, True])
def test_places_follow_from_velocities(has_ball: bool) -> None:
    """Their derivatives, too, stage by stage."""
    dynamics, rng = make(has_ball), np.random.default_rng(4)
    scheme = schemes.build(schemes.Family.RADAU, 2)
    A, b = scheme.integration, scheme.weights
    places, q, V = Places(dynamics, A, b), start(dynamics).q, rng.standard_normal((2, N))
    Q = places.stages(q, V, H)
    assert places.are_integrals != has_ball
    assert pytest.approx(place(dynamics, A, q, V), abs=1e-13) == Q
    mean = b[0] * dynamics.rate(Q[0], V[0]) + b[1] * dynamics.rate(Q[1], V[1])
    assert places.end(q, Q, V, H) == pytest.approx(q + H * mean)
    K = rng.standard_normal((2, N, dynamics.places))
    found = places.stiffen(K, Q, V, H)
    by_v = slope(lambda x: place(dynamics, A, q, x.reshape(2, N)).ravel(), V.ravel()).reshape(2, -1, 2, N)
    for i in range(2):
        for j in range(2):
            assert found[i, j] == pytest.approx(K[i] @ by_v[i, :, j], rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("piece", [PIECE, FOLLOWED])
def test_symplectic_euler_solves_its_equation(monkeypatch: pytest.MonkeyPatch, piece: Piece) -> None:
    """M (w - qd) + h (Phi(q, w, 0) - B w) = 0 with B = d(M w)/dq, at the inputs of the step's start.

    Newton's matrix is M + h (D - B^T); D is the part of dPhi/dw that is even in w: the inertia's own part is odd.
    """
    dynamics, rng = make(False), np.random.default_rng(4)
    scheme, state, w = make_symplectic(dynamics, piece, Settings(2.0)), start(dynamics), rng.standard_normal(N)
    newton = Capture(w)
    monkeypatch.setattr(implicit, "iterate", newton)
    after = scheme.step(state, TIME, H)
    v, rest = piece.at(TIME, state.q, state.qd), np.zeros(N)

    def weigh(q: Array) -> Array:
        return np.asarray(dynamics.kernels.shape.mass(dynamics.pad(q)))

    M, B = weigh(state.q), slope(lambda q: weigh(q) @ w, state.q)
    residual = M @ (w - state.qd) + H * (dynamics.residual(state.q, w, rest, v) - B @ w)
    damping = [slope(lambda x: dynamics.residual(state.q, x, rest, v), y) for y in (w, -w)]
    matrix = M + H * ((damping[0] + damping[1]) / 2 - B.T)
    assert newton.correct(w) == pytest.approx(-np.linalg.solve(matrix, residual), rel=1e-9, abs=1e-9)
    assert newton.guess is state.qd
    assert newton.scale == pytest.approx(scale_velocities(state, H))
    end = state.q + H * w
    assert after.q == pytest.approx(end, abs=1e-13)
    assert weigh(end) @ after.qd == pytest.approx(M @ w, abs=1e-12)
    assert not after.qdd.any()
    assert (after.stage_q.tolist(), after.stage_qd.tolist()) == ([after.q.tolist()], [w.tolist()])
    assert scheme.points is None
    assert scheme.weights is None


@pytest.mark.parametrize("piece", [PIECE, FOLLOWED])
def test_accelerations_at_the_start_solve_the_residual(piece: Piece) -> None:
    dynamics = make(True)
    state = start(dynamics)
    at = Piece(TIME, 2.0, piece.values, False, piece.law)
    qdd = find_start(dynamics, at, state.q, state.qd)
    v = at.at(TIME, state.q, state.qd)
    assert dynamics.residual(state.q, state.qd, qdd, v) == pytest.approx(np.zeros(N), abs=1e-11)
    flat: Any = SimpleNamespace(
        stiffnesses=lambda *_: (0, 0, np.zeros((N, N))), residual=lambda *_: np.ones(N), find_pivot=lambda _: "j1"
    )
    with pytest.raises(SingularError) as caught:
        find_start(flat, at, np.zeros(N), np.zeros(N))
    assert caught.value.joint == "j1"


@pytest.mark.parametrize("points", [[1.0], [1 / 3, 1.0], [0.1, 0.5, 0.9]])
def test_polynomials_are_extrapolated_to_1(points: list[float]) -> None:
    x = np.array(points)
    for k in range(len(points)):
        assert extrapolate(x) @ (2 * x) ** k == pytest.approx(2.0**k)


def test_changes_are_relative_to_the_state() -> None:
    """h/(1 + |qd|) + h^2/(1 + |q|) by an acceleration of 1; quaternions leave coordinates out of the scale."""
    none = np.zeros((1, 2))
    state = State(np.array([-1.0, 4.0]), np.array([3.0, -1.0]), none[0], none, none)
    assert scale_velocities(state, 0.5) == pytest.approx([1 / 4 + 0.5 / 2, 1 / 2 + 0.5 / 5])
    assert scale_changes(state, 0.5) == pytest.approx([1 / 8 + 0.25 / 2, 1 / 4 + 0.25 / 5])
    turned = State(np.array([-1.0, 4.0, 1.0]), np.array([3.0, -1.0]), none[0], none, none)
    assert scale_velocities(turned, 0.5) == pytest.approx([1 / 4 + 0.5, 1 / 2 + 0.5])


# --- Newton's method -------------------------------------------------------------------------------------------------


def run_newton(changes: list[list[float]], scale: list[float], noise: float = 0.0) -> tuple[Array, int]:
    """Return the result of given changes, the last of which goes on, and how many were made."""
    dynamics = make(False)
    given = iter([np.array(x) for x in changes])
    last = [np.array(changes[-1])]
    z = iterate(dynamics, lambda _: next(given, last[0]), np.zeros(len(changes[0])), np.array(scale), noise)
    return z, dynamics.effort.iterations


def test_newtons_method_ends_where_changes_are_small() -> None:
    """1e-10 times its scale, of the largest entry, and the last change is made."""
    assert run_newton([[1.0, 0.0], [0.9e-10, -0.4e-10]], [1.0, 2.0])[1] == 2
    z, count = run_newton([[1.0, 0.0], [0.0, -0.6e-10], [0.0, -0.4e-10]], [1.0, 2.0])
    assert (z.tolist(), count) == ([1.0, pytest.approx(-1e-10)], 3)
    assert run_newton([[1e-10]], [1.0])[1] == 1


def test_changes_that_shrink_no_more_within_noise_are_rounding() -> None:
    """By less than a half from one to the next."""
    assert run_newton([[1.0], [1e-8], [0.6e-8], [0.0]], [1.0], 1e-7)[1] == 3
    assert run_newton([[1.0], [1e-8], [0.4e-8], [0.0]], [1.0], 1e-7)[1] == 4
    assert run_newton([[1.0], [2e-7], [1.9e-7], [0.0]], [1.0], 1e-7)[1] == 4
    assert run_newton([[0.9e-7], [0.0]], [1.0], 1e-7)[1] == 2


def test_newtons_method_names_the_joint_that_does_not_settle() -> None:
    for changes, scale, name, count in (
        ([[1.0, -3.0, 2.0]], [1.0, 1.0, 1.0], "j1", 25),
        ([[1.0, -3.0, 2.0]], [1.0, 1.0, 2.0], "j2", 25),
        ([[5.0, 1.0, 1.0], [np.nan, np.inf, 0.0]], [1.0, 1.0, 1.0], "j0", 2),
    ):
        dynamics = make(False)
        given = iter([np.array(x) for x in changes])
        last = np.array(changes[-1])
        with pytest.raises(implicit._StuckError) as caught:
            iterate(dynamics, lambda _, given=given, last=last: next(given, last), np.zeros(3), np.array(scale))  # type: ignore[misc]
        assert (caught.value.joint, dynamics.effort.iterations) == (name, count)
        assert caught.value.finding == "Newton's method does not converge within 25 iterations"


# --- along a piece ---------------------------------------------------------------------------------------------------


def run(step: Callable[[State, float, float], State], piece: Piece, h: float, **given: Any) -> tuple[list[Any], Any]:
    """Go along a piece by given steps; return the chunks, and the halt."""
    dynamics, chunks = make(False), []
    scheme = Scheme(lambda *_: np.full(N, 7.0), step, given.get("points"), given.get("weights"))
    allowance = Allowance(Limits(steps=given.get("steps", 10**6)))
    try:
        state, settings = (np.zeros(N), np.ones(N)), Settings(9.0, step=h)
        for chunk in integrate(lambda *_: scheme, dynamics, piece, *state, settings, allowance):
            chunks.append(chunk)
    except HaltError as error:
        return chunks, (error.halt, dynamics.effort.steps)
    return chunks, dynamics.effort.steps


def advance(state: State, time: float, h: float) -> State:
    """Add the length of a step to coordinates, and the time to velocities."""
    q = state.q + h
    return State(q, np.full(N, time), state.qdd, np.stack((state.q, q)), np.stack((state.qd, state.qd)))


def test_a_piece_has_equal_steps_that_come_in_groups() -> None:
    piece = Piece(1.0, 3.0, drive, False)
    (chunk,), steps = run(advance, piece, 0.6)
    assert steps == 4
    assert chunk.t.tolist() == [1.0, 1.5, 2.0, 2.5, 3.0]
    assert chunk.q[:, 0].tolist() == [0.0, 0.5, 1.0, 1.5, 2.0]
    assert chunk.qd[:, 0].tolist() == [1.0, 1.0, 1.5, 2.0, 2.5]
    assert chunk.stages is None
    (chunk,), _ = run(advance, piece, 1.0, points=np.array([0.25, 1.0]), weights=np.array([0.5, 0.5]))
    assert chunk.stages.t.tolist() == [[1.25, 2.0], [2.25, 3.0]]
    assert chunk.stages.q[:, :, 0].tolist() == [[0.0, 1.0], [1.0, 2.0]]
    assert chunk.stages.qd[:, :, 0].tolist() == [[1.0, 1.0], [1.0, 1.0]]
    chunks, steps = run(advance, Piece(0.0, 1025.0, drive, False), 1.0)
    assert ([len(x.t) for x in chunks], steps) == ([513, 513, 2], 1025)
    assert [x.t[0] for x in chunks] == [0.0, 512.0, 1024.0]
    chunks, _ = run(advance, Piece(0.0, 512.0, drive, False), 1.0)
    assert [len(x.t) for x in chunks] == [513]


@pytest.mark.parametrize("at", [0, 3])
def test_a_step_that_fails_halts_the_motion(at: int) -> None:
    """The steps before it are kept; the finding says why, and where the joint is known, which."""
    stuck, kernel = implicit._StuckError("j2"), KernelError.__new__(KernelError)
    kernel.joint, kernel.loop = "j4", None
    for error, finding, joint in (
        (stuck, "Newton's method does not converge", "j2"),
        (np.linalg.LinAlgError(), "the accelerations cannot be computed here", None),
        (SingularError("j1"), "the accelerations cannot be computed here", "j1"),
        (LimitError("too many", "raise it"), "too many", None),
        (kernel, "the accelerations cannot be computed here", "j4"),
    ):

        def fail(state: State, time: float, h: float, error: Exception = error) -> State:
            if time == at:
                raise error
            return advance(state, time, h)

        chunks, (halt, steps) = run(fail, Piece(0.0, 5.0, drive, False), 1.0)
        assert [x.t.tolist() for x in chunks] == ([[0.0, 1.0, 2.0, 3.0]] if at else [])
        assert (halt.time, halt.joint, steps) == (at, joint, at)
        assert finding in halt.finding


def test_numbers_that_overflow_halt_the_motion_at_the_joint_that_moved_most() -> None:
    def burst(state: State, time: float, h: float) -> State:
        qd = np.array([1.0, -5.0, 2.0, 0.0, 0.0, 0.0])
        bad = advance(state, time, h)
        if time < 1:
            return State(bad.q, qd, bad.qdd, bad.stage_q, bad.stage_qd)
        q = np.where(np.arange(N) == 3, np.inf if time < 2 else 0.0, bad.q)
        return State(q, bad.qd, bad.qdd, bad.stage_q, bad.stage_qd)

    chunks, (halt, _) = run(burst, Piece(0.0, 3.0, drive, False), 1.0)
    assert (len(chunks), halt.joint, halt.time) == (1, "j1", 1.0)
    assert halt.finding == "the motion diverges: its numbers overflow"
    assert halt.remedy == "take a smaller step"

    def spin(state: State, time: float, h: float) -> State:
        bad = advance(state, time, h)
        return State(bad.q, np.full(N, np.nan), bad.qdd, bad.stage_q, bad.stage_qd)

    assert run(spin, Piece(0.0, 3.0, drive, False), 1.0)[1][0].joint == "j0"


def test_inputs_without_a_value_are_an_error_unless_they_follow_the_state() -> None:
    def fail(*_: Any) -> State:
        raise DriveError("no value", "mend it")

    with pytest.raises(DriveError):
        run(fail, Piece(0.0, 3.0, drive, False), 1.0)
    _, (halt, _) = run(fail, Piece(0.0, 3.0, drive, False, follow_state), 1.0)
    assert (halt.finding, halt.remedy) == ("no value", "mend it")
    chunks, (halt, steps) = run(advance, Piece(0.0, 3.0, drive, False), 1.0, steps=2)
    assert (len(chunks[0].t), steps, halt.remedy) == (3, 2, "raise max_steps")
