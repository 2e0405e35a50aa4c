"""Implicit steps of loops by their equations: Newton's steps solve the linearised ones exactly, by complex steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsrun.ocp.ground import schemes
from mbsrun.simulation.drive import Piece
from mbsrun.simulation.formulation import Formulation
from mbsrun.simulation.integration import multipliers, radau
from mbsrun.simulation.integration.implicit import State, extrapolate, scale_changes
from mbsrun.simulation.integration.multipliers import Loops, make_alpha, make_radau
from mbsrun.simulation.motion import Settings
from tests.mbsrun.simulation.curved import PIECE, N, Shape, drive, slope

Array = NDArray[Any]

H, TIME, DRIVEN = 0.2, 0.6, 4


def guide(t: Any) -> tuple[Any, Any, Any]:
    """Return the coordinate, velocity and acceleration of the driven joint."""
    return np.sin(2 * t), 2 * np.cos(2 * t), -4 * np.sin(2 * t)


@dataclass(frozen=True)
class Loop:
    """Six slides with the inertia of `curved`, and loops: h(q) = 0, hd = J(q) qd; J is no derivative of h."""

    shape: Shape
    loops: int
    driven: tuple[int, ...]
    effort: Any = field(default_factory=lambda: SimpleNamespace(iterations=0, evaluations=0, jacobians=0))
    size: int = N
    places: int = N
    formulation: Any = Formulation.IMPL

    @property
    def kernels(self) -> Any:
        """Return the kernels of loops, with the manifest."""
        names = tuple(f"j{k}" for k in range(N))
        call: Any = _Kernels(self)
        call.manifest = SimpleNamespace(
            quaternions=(),
            positions=names,
            coordinates=[SimpleNamespace(name=x) for x in names],
            configuration=False,
            owners=tuple(range(self.loops)),
            driven=self.driven,
        )
        return call

    @property
    def course(self) -> Any:
        """Return the motion of driven joints."""
        return SimpleNamespace(states=lambda t: tuple(x[:, None] for x in guide(t)))

    def gap(self, q: Array) -> Array:
        """Return h."""
        return np.asarray(self.shape.read("clearance", np.append(q, 0.5))[: self.loops])

    def pull(self, q: Array) -> Array:
        """Return J."""
        return np.asarray(self.shape.read("slide", np.append(q, 0.5))[0, : self.loops])

    def residual(self, q: Array, qd: Array, qdd: Array, v: Array, lam: Array) -> Array:
        """Return Phi of one state, with the forces of loops."""
        return np.asarray(self.shape.residual(np.append(q, 0.5), qd, qdd, v) - self.pull(q).T @ lam)

    def call(self, _: str, q: Array, qd: Array, v: Array, qdd: Array, lam: Array) -> dict[str, Array]:
        """Return Phi with its derivatives."""
        found: dict[str, list[Array]] = {"Phi": []}
        states: list[Any] = list(zip(q, qd, qdd, v, lam, strict=True))
        for at in states:
            found["Phi"].append(self.residual(*at))
            for k, name in ((0, "q"), (1, "qd"), (2, "qdd"), (4, "lam")):
                if at[k].size:
                    found.setdefault(f"jac_Phi_{name}", []).append(self.vary(at, k))
        return {name: np.array(x) for name, x in found.items()}

    def vary(self, at: Any, k: int) -> Array:
        """Differentiate Phi by one of its arguments."""

        def evaluate(x: Array) -> Array:
            given = [*at]
            given[k] = x
            return self.residual(*given)

        return slope(evaluate, at[k])

    def input_slopes(self, q: Array, *_: Any) -> Array:
        """Differentiate Phi by the inputs."""
        return np.array([-self.shape.inputs] * len(q))  # type: ignore[attr-defined]

    def rates(self, _: Array, qd: Array) -> Array:
        """Return the rates of coordinates."""
        return qd


class _Kernels:
    manifest: Any

    def __init__(self, loop: Loop) -> None:
        self.loop = loop

    def __call__(self, name: str, q: Array, qd: Array | None = None) -> dict[str, Array]:
        loop = self.loop
        if name == "loop_jacobian":
            assert qd is not None
            return {"J": loop.pull(q), "gamma": slope(lambda x: loop.pull(x) @ qd, q) @ qd}
        if qd is None:
            return {"gap": np.array([loop.gap(x) for x in q]), "jac_gap_q": np.array([slope(loop.gap, x) for x in q])}
        pairs = list(zip(q, qd, strict=True))
        return {
            "hd": np.array([loop.pull(x) @ w for x, w in pairs]),
            "jac_hd_q": np.array([self.turn(x, w) for x, w in pairs]),
            "jac_hd_qd": np.array([loop.pull(x) for x, _ in pairs]),
        }

    def turn(self, q: Array, w: Array) -> Array:
        """Differentiate J w."""
        return slope(lambda x: self.loop.pull(x) @ w, q)


def follow_state(t: Array, q: Array, qd: Array) -> Array:
    """Return inputs that follow the state."""
    return np.stack((t + 0.3 * q[:, 0] - qd[:, 1], 2 * qd[:, 3] + q[:, 2] * t), axis=1)


FOLLOWED = Piece(0.3, 2.0, drive, False, follow_state)
KINDS = [(2, ()), (2, (DRIVEN,)), (0, (DRIVEN,))]


def make(loops: int, driven: tuple[int, ...]) -> Any:
    """Draw a mechanism."""
    return Loop(Shape(np.random.default_rng(5)), loops, driven)


def begin(seed: int = 3) -> State:
    """Draw the end of a step."""
    q, qd, qdd = np.random.default_rng(seed).standard_normal((3, N))
    return State(q, qd, qdd, q[None], qd[None])


class Capture:
    """In place of Newton's method: keeps its functions, and returns given numbers."""

    def __init__(self, result: Array) -> None:
        self.result, self.noise = result, 0.0
        self.correct: Callable[[Array], Array] = lambda z: z
        self.guess, self.scale = np.zeros(0), np.zeros(0)

    def __call__(self, _: Any, correct: Callable[[Array], Array], guess: Array, scale: Array, noise: float) -> Array:
        self.correct, self.guess, self.scale, self.noise = correct, guess, scale, noise
        return self.result


Function = Callable[[Array], Array]


def expect_newton(correct: Function, miss: Function, z: Array, fixed: list[int], tol: float) -> None:
    """Compare a step with the one that the derivative of the equations gives; fixed unknowns do not change."""
    flat = z.ravel()
    by_z, right = slope(lambda x: miss(x.reshape(z.shape)).ravel(), flat), miss(z).ravel()
    for k in fixed:
        by_z[k], by_z[:, k], right[k] = 0.0, 0.0, 0.0
        by_z[k, k] = 1.0
    expected = -np.linalg.solve(by_z, right)
    assert correct(z).ravel() == pytest.approx(expected, rel=tol, abs=tol)


def drive_state(dynamics: Any, t: Any, q: Array, qd: Array, qdd: Array) -> tuple[Array, Array, Array]:
    """Put the driven joint where it is."""
    found = q.copy(), qd.copy(), qdd.copy()
    if dynamics.driven:
        for x, given in zip(found, guide(t), strict=True):
            x[DRIVEN] = given
    return found


@pytest.mark.parametrize(("loops", "driven"), KINDS)
@pytest.mark.parametrize("piece", [PIECE, FOLLOWED])
def test_accelerations_and_multipliers_at_the_start(loops: int, driven: tuple[int, ...], piece: Piece) -> None:
    """Phi = 0 of joints that are not driven, and J qdd + gamma = 0."""
    dynamics, state = make(loops, driven), begin()
    qdd, lam = Loops(dynamics, piece).start(state.q.copy(), state.qd.copy())
    q, qd, given = drive_state(dynamics, piece.start, state.q, state.qd, qdd)
    assert given == pytest.approx(qdd)
    free = [k for k in range(N) if k not in driven]
    v = piece.at(piece.start, q, qd)
    assert dynamics.residual(q, qd, qdd, v, lam)[free] == pytest.approx(np.zeros(len(free)), abs=1e-9)
    gamma = slope(lambda x: dynamics.pull(x) @ qd, q) @ qd if loops else np.zeros(0)
    assert dynamics.pull(q) @ qdd + gamma == pytest.approx(np.zeros(loops), abs=1e-9)
    assert (dynamics.effort.evaluations, dynamics.effort.jacobians) == (1, 1)


@pytest.mark.parametrize(("loops", "driven"), KINDS)
@pytest.mark.parametrize("piece", [PIECE, FOLLOWED])
@pytest.mark.parametrize("rho", [0.0, 0.6])
def test_generalised_alpha_solves_its_equations(
    monkeypatch: pytest.MonkeyPatch, loops: int, driven: tuple[int, ...], piece: Piece, rho: float
) -> None:
    """Arnold, Bruls (2007), section 3: Phi = 0 and h = 0 at the end; a and lam go from step to step."""
    dynamics, rng, state = make(loops, driven), np.random.default_rng(4), begin()
    scheme = make_alpha(dynamics, piece, Settings(2.0, rho=rho))
    alpha_m, alpha_f = (2 * rho - 1) / (rho + 1), rho / (rho + 1)
    gamma = 1 / 2 + alpha_f - alpha_m
    beta = (gamma + 1 / 2) ** 2 / 4
    a = scheme.start(state.q.copy(), state.qd.copy())
    lam = Loops(dynamics, piece).start(state.q.copy(), state.qd.copy())[1]
    for time in (TIME, TIME + H):
        z = rng.standard_normal(N + loops)
        newton = Capture(z)
        monkeypatch.setattr(multipliers, "iterate", newton)
        after = scheme.step(state, time, H)

        def move(z: Array, time: float = time, state: State = state, a: Array = a) -> tuple[Array, Array, Array, Array]:
            new = ((1 - alpha_f) * z[:N] + alpha_f * state.qdd - alpha_m * a) / (1 - alpha_m)
            q = state.q + H * state.qd + H**2 * ((0.5 - beta) * a + beta * new)
            return (*drive_state(dynamics, time + H, q, state.qd + H * ((1 - gamma) * a + gamma * new), z[:N]), new)

        def miss(z: Array, time: float = time, move: Any = move) -> Array:
            q, qd, qdd, _ = move(z)
            phi = dynamics.residual(q, qd, qdd, piece.at(time + H, q, qd), z[N:])
            return np.concatenate((phi, dynamics.gap(q)))

        expect_newton(newton.correct, miss, z, list(driven), 1e-5 if piece.law else 1e-8)
        assert newton.guess == pytest.approx(np.concatenate((state.qdd, lam)))
        assert newton.scale == pytest.approx(np.concatenate((scale_changes(state, H), np.zeros(loops))))
        assert newton.noise == 1e-7
        q, qd, qdd, a = move(z)
        lam = z[N:]
        for found, expected in ((after.q, q), (after.qd, qd), (after.qdd, qdd)):
            assert found == pytest.approx(expected, abs=1e-12)
        assert after.stage_q.tolist() == [state.q.tolist(), after.q.tolist()]
        assert after.stage_qd.tolist() == [state.qd.tolist(), after.qd.tolist()]
        state = after
    assert scheme.points is not None
    assert scheme.weights is not None
    assert (scheme.points.tolist(), scheme.weights.tolist()) == ([0.0, 1.0], [0.5, 0.5])


@pytest.mark.parametrize(("loops", "driven"), KINDS)
@pytest.mark.parametrize("piece", [PIECE, FOLLOWED])
@pytest.mark.parametrize("stages", [1, 2])
def test_radau_collocation_solves_its_equations(
    monkeypatch: pytest.MonkeyPatch, loops: int, driven: tuple[int, ...], piece: Piece, stages: int
) -> None:
    """Phi = 0, h = 0 and J v = 0 at the stages, where q' = v + B mu with B = J^T at the start of the step."""
    monkeypatch.setattr(radau, "is_taken", lambda *_: False)
    dynamics, rng, state = make(loops, driven), np.random.default_rng(4), begin()
    scheme = schemes.build(schemes.Family.RADAU, stages)
    made = make_radau(dynamics, piece, Settings(2.0, stages=stages))
    A, c, e = scheme.integration, scheme.points, loops
    qdd, lam = Loops(dynamics, piece).start(state.q.copy(), state.qd.copy())
    assert made.start(state.q.copy(), state.qd.copy()) == pytest.approx(qdd)
    guess = np.tile(np.concatenate((qdd, lam, np.zeros(e))), (stages, 1))
    for time in (TIME, TIME + H):
        z = rng.standard_normal((stages, N + 2 * e))
        newton = Capture(z)
        monkeypatch.setattr(multipliers, "iterate", newton)
        after = made.step(state, time, H)
        B = dynamics.pull(state.q).T.copy()
        B[list(driven)] = 0

        def move(z: Array, time: float = time, state: State = state, B: Array = B) -> list[tuple[Array, Array, Array]]:
            V = state.qd + H * A @ z[:, :N]
            if driven:
                V[:, DRIVEN] = guide(time + H * c)[1]
            Q = state.q + H * A @ (V + z[:, N + e :] @ B.T)
            return [drive_state(dynamics, time + H * t, *x) for *x, t in zip(Q, V, z[:, :N], c, strict=True)]

        def miss(z: Array, time: float = time, move: Any = move) -> Array:
            found = []
            for (q, qd, qdd), own, t in zip(move(z), z, c, strict=True):
                v = piece.at(time + H * t, q, qd)
                phi = dynamics.residual(q, qd, qdd, v, own[N : N + e])
                found.append(np.concatenate((phi, dynamics.gap(q), dynamics.pull(q) @ qd)))
            return np.array(found)

        fixed = [k * (N + 2 * e) + i for k in range(stages) for i in driven]
        expect_newton(newton.correct, miss, z, fixed, 1e-5 if piece.law else 1e-8)
        assert newton.guess == pytest.approx(guess)
        assert newton.scale == pytest.approx(np.concatenate((scale_changes(state, H), np.zeros(e), np.full(e, H))))
        assert newton.noise == 1e-7
        at = move(z)
        for found, k in ((after.stage_q, 0), (after.stage_qd, 1)):
            assert found == pytest.approx(np.array([x[k] for x in at]), abs=1e-12)
        for found, expected in zip((after.q, after.qd, after.qdd), at[-1], strict=True):
            assert found == pytest.approx(expected, abs=1e-12)
        guess, state = np.tile(extrapolate(c) @ z, (stages, 1)), after
    assert made.points is c
    assert made.weights is scheme.weights
