"""Variational steps by their equations (1) and (2): Newton's steps, the momenta at the end, and driven joints."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsrun.limits import Allowance, Limits
from mbsrun.simulation.drive import Piece
from mbsrun.simulation.integration import implicit, rattle, variational
from mbsrun.simulation.integration.groups import find_group
from mbsrun.simulation.integration.implicit import find_start, scale_velocities
from mbsrun.simulation.integration.multipliers import Loops
from mbsrun.simulation.integration.variational import _bundle, _Mechanism, integrate, make
from mbsrun.simulation.motion import HaltError, Settings
from tests.mbsrun.simulation import test_implicit_steps as trees
from tests.mbsrun.simulation import test_loop_steps as loops
from tests.mbsrun.simulation.curved import PIECE, N, Shape, drive, slope

Array = NDArray[Any]

H, TIME = 0.2, 0.6
FOLLOWED = Piece(0.3, 2.0, drive, False, loops.follow_state)


class Moved:
    """Everything at one place that the equations need, of either mechanism."""

    def __init__(self, dynamics: Any, q: Array, w: Array) -> None:
        self.dynamics, self.q, self.w = dynamics, q, w
        pad = (lambda x: x) if getattr(dynamics, "has_ball", False) else (lambda x: np.append(x, 0.5))
        shape = getattr(dynamics, "shape", None) or dynamics.kernels.shape

        def weigh(x: Array) -> Array:
            return np.asarray(shape.mass(pad(x)))

        def force(x: Array, speed: Array, v: Array) -> Array:
            return np.asarray(shape.residual(pad(x), speed, np.zeros(N), v))

        self.M, self.force = weigh(q), force
        along = dynamics.rate_slopes(q, w)[1]
        self.B = slope(lambda x: weigh(x) @ w, q) @ along

    def push(self, v: Array, group: Any) -> Array:
        """Return G."""
        w = self.w
        return np.asarray(self.B @ w + group.gyrate(w, self.M @ w) - self.force(self.q, w, v))

    def steepen(self, v: Array) -> Array:
        """Return the derivative of G by w that Newton's method takes."""
        parts = [slope(lambda x: self.force(self.q, x, v), y) for y in (self.w, -self.w)]
        return np.asarray(self.B.T - (parts[0] + parts[1]) / 2)


@dataclass(frozen=True)
class Tree(trees.Mechanism):
    """The same tree, with the functions that variational steps call."""

    def linearise(self, q: Array, qd: Array, qdd: Array, v: Array) -> tuple[Array, ...]:
        """Return the residual with its derivatives."""
        return (self.residual(q, qd, qdd, v), *self.stiffnesses(q, qd, qdd, v))

    @property
    def course(self) -> Any:
        """Return the motion of no joint."""
        return SimpleNamespace(at=lambda _: (np.zeros(0),) * 3)


@dataclass(frozen=True)
class Chain(loops.Loop):
    """The same loops, with the functions that variational steps call."""

    @property
    def kernels(self) -> Any:
        """Return kernels that take one state, too."""
        call, gap = super().kernels, self.gap

        class Single:
            manifest: Any = SimpleNamespace(**vars(call.manifest), inputs=("a", "b"))

            def __call__(self, name: str, q: Array, **given: Array) -> dict[str, Array]:
                if name == "loops" and q.ndim == 1:
                    return {"gap": gap(q)}
                return dict(call(name, q=q, **given))

        return Single()

    def linearise(self, q: Array, qd: Array, qdd: Array, v: Array) -> tuple[Array, ...]:
        """Return the residual without the forces of loops, with its derivatives."""
        found = self.call("", q, qd, v, qdd, np.zeros((len(q), self.loops)))
        return found["Phi"], found["jac_Phi_q"], found["jac_Phi_qd"], found["jac_Phi_qdd"]

    def rate_slopes(self, *_: Array) -> tuple[Array, Array]:
        """Differentiate the rates."""
        return np.zeros((N, N)), np.eye(N)

    def solve(self, M: Array, right: Array) -> Array:
        """Return M^-1 right."""
        return np.asarray(np.linalg.solve(M, right))

    @property
    def course(self) -> Any:
        """Return the motion of driven joints."""
        count = len(self.driven)
        given = loops.guide
        return SimpleNamespace(
            at=lambda t: tuple(np.full(count, x) for x in given(t)),
            states=lambda t: tuple(np.tile(x[:, None], (1, count)) for x in given(t)),
        )


def make_one(kind: str) -> Any:
    """Make a mechanism: slides, with a ball, or with loops."""
    if kind in ("slides", "ball"):
        return Tree(**vars(trees.make(kind == "ball")))
    count, driven = {"loops": (2, ()), "driven": (0, (loops.DRIVEN,)), "both": (2, (loops.DRIVEN,))}[kind]
    return Chain(Shape(np.random.default_rng(5)), count, driven)


def follow(time: float, q: Array, w: Array) -> Array:
    """Return inputs that follow a state."""
    return np.asarray(loops.follow_state(np.array([time]), q[None], w[None])[0])


@pytest.mark.parametrize("kind", ["slides", "ball", "loops", "driven", "both"])
@pytest.mark.parametrize("piece", [PIECE, FOLLOWED])
def test_steps_solve_their_equations(monkeypatch: pytest.MonkeyPatch, kind: str, piece: Piece) -> None:
    """(1) for the velocity of the step and the multipliers at its start, then (2) for the velocities at its end."""
    dynamics, rng = make_one(kind), np.random.default_rng(4)
    group = find_group(dynamics.kernels)
    driven = list(getattr(dynamics, "driven", ()))
    e = getattr(dynamics, "loops", 0)
    pull = dynamics.pull if e else lambda _: np.zeros((0, N))
    state = trees.start(dynamics) if kind in ("slides", "ball") else loops.begin()
    scheme = make(dynamics, piece, Settings(2.0))
    lam, is_closed = np.zeros(e), kind not in ("slides", "ball")
    assert scheme.points is not None
    assert scheme.weights is not None
    assert (scheme.points.tolist(), scheme.weights.tolist()) == ([0.0, 1.0], [0.5, 0.5])
    for time in (TIME, TIME + H):
        z = rng.standard_normal(N + e)
        newton = loops.Capture(z)
        monkeypatch.setattr(variational, "iterate", newton)
        after = scheme.step(state, time, H)
        q, qd, w = state.q, state.qd, z[:N]
        end = group.move(q, H * w)
        near, far = Moved(dynamics, q, w), Moved(dynamics, end, w)

        def weigh(w: Array, q: Array = q) -> Array:
            """Return the momentum of the step, at its start."""
            places = q, group.move(q, H * w)
            return np.asarray(group.trivialise(H * w).T @ sum(Moved(dynamics, x, w).M for x in places) @ w / 2)

        v = piece.at(time, q, w)
        by_w = np.stack([(weigh(w + 1e-5 * x) - weigh(w - 1e-5 * x)) / 2e-5 for x in np.eye(N)], axis=1)
        steep = near.steepen(v)
        if piece.law is not None:
            shape = getattr(dynamics, "shape", None) or dynamics.kernels.shape
            steep = steep + shape.inputs @ slope(partial(follow, time, q), w)
        matrix = np.block([[by_w - H / 2 * steep, -H / 2 * pull(q).T], [pull(end), np.zeros((e, e))]])
        gap = dynamics.gap(end) / H if e else np.zeros(0)
        right = weigh(w) - near.M @ qd - H / 2 * (near.push(v, group) + pull(q).T @ z[N:])
        right = np.concatenate((right, gap))
        matrix[driven], matrix[:, driven], right[driven] = 0, 0, 0
        matrix[driven, driven] = 1
        assert newton.correct(z) == pytest.approx(-np.linalg.solve(matrix, right), rel=1e-5, abs=1e-6)
        guess = np.concatenate((qd + H / 2 * state.qdd, lam))
        guess[driven] = (loops.guide(time + H)[0] - loops.guide(time)[0]) / H
        assert newton.guess == pytest.approx(guess)
        assert newton.scale == pytest.approx(np.concatenate((scale_velocities(state, H), np.zeros(e))))
        assert newton.noise == (1e-7 if is_closed else 0.0)
        momentum = group.trivialise(-H * w).T @ (near.M + far.M) @ w / 2
        momentum = momentum + H / 2 * far.push(piece.at(time + H, end, w), group)
        free = [k for k in range(N) if k not in driven]
        whole = np.block([[far.M, -pull(end).T], [pull(end), np.zeros((e, e))]])
        chosen = [*free, *range(N, N + e)]
        given = np.zeros(N + e)
        given[driven] = loops.guide(time + H)[1]
        rest = np.concatenate((momentum, np.zeros(e))) - whole @ given
        given[chosen] = np.linalg.solve(whole[np.ix_(chosen, chosen)], rest[chosen])
        assert after.q == pytest.approx(end, abs=1e-12)
        assert after.qd == pytest.approx(given[:N], rel=1e-8, abs=1e-8)
        assert after.qdd == pytest.approx((after.qd - qd) / H)
        assert after.stage_q.tolist() == [q.tolist(), after.q.tolist()]
        assert after.stage_qd.tolist() == [w.tolist(), w.tolist()]
        state, lam = after, z[N:]


@pytest.mark.parametrize("kind", ["slides", "both"])
def test_accelerations_and_multipliers_at_the_start(kind: str) -> None:
    """Multipliers are the guess of the first step."""
    dynamics = make_one(kind)
    state = trees.start(dynamics) if kind == "slides" else loops.begin()
    mechanism = _Mechanism(dynamics, PIECE)
    q, qd = state.q.copy(), state.qd.copy()
    if kind == "slides":
        assert mechanism.start(q, qd) == pytest.approx(find_start(dynamics, PIECE, q, qd))
        assert mechanism.start_lam(q, qd).tolist() == []
        return
    qdd, lam = Loops(dynamics, PIECE).start(q.copy(), qd.copy())
    assert mechanism.start(q.copy(), qd.copy()) == pytest.approx(qdd)
    assert mechanism.lam == pytest.approx(lam)
    assert _Mechanism(dynamics, PIECE).start_lam(q.copy(), qd.copy()) == pytest.approx(lam)


def test_steps_have_both_their_ends_as_stages() -> None:
    states = np.arange(9.0).reshape(3, 3)
    chunk = _bundle(np.array([0.0, 0.5, 1.5]), states, np.array([[10.0], [20.0]]), 2)
    assert chunk.q.tolist() == [[0.0, 1.0], [3.0, 4.0], [6.0, 7.0]]
    assert chunk.qd.tolist() == [[2.0], [5.0], [8.0]]
    stages = chunk.stages
    assert stages is not None
    assert stages.t.tolist() == [[0.0, 0.5], [0.5, 1.5]]
    assert stages.q.tolist() == [[[0.0, 1.0], [3.0, 4.0]], [[3.0, 4.0], [6.0, 7.0]]]
    assert stages.qd.tolist() == [[[10.0], [10.0]], [[20.0], [20.0]]]
    assert stages.weights.tolist() == [0.5, 0.5]


def run(monkeypatch: pytest.MonkeyPatch, count: int, stop: int = 10**9, steps: int = 10**9) -> Any:
    """Go along steps of 1 s in place of the ones in C, which fail after `stop` ones."""
    calls: list[tuple[float, int, list[float]]] = []
    rest: list[tuple[float, list[float]]] = []
    dynamics = make_one("slides")
    taken = [0]

    def take(h: float, _v: Array, row: Array, _guess: Array, steps: int) -> tuple[int, Array, Array]:
        calls.append((h, steps, row[:1].tolist()))
        done = min(steps, stop - taken[0])
        taken[0] += done
        return done, row + np.arange(done + 1)[:, None], np.zeros((done, N))

    object.__setattr__(dynamics, "kept", {"stepper": SimpleNamespace(run=take)})
    monkeypatch.setattr(rattle, "is_taken", lambda *_: True)

    def go_on(_m: Any, _d: Any, piece: Piece, q: Array, *_: Any) -> list[Any]:
        rest.append((piece.start, q.tolist()))
        return []

    monkeypatch.setattr(implicit, "integrate", go_on)
    piece, allowance = Piece(0.0, float(count), drive, False), Allowance(Limits(steps=steps))
    chunks, halt = [], None
    try:
        for chunk in integrate(dynamics, piece, np.zeros(N), np.ones(N), Settings(9.0, step=1.0), allowance):
            chunks.append((chunk.t[0], chunk.t[-1], chunk.q[0, 0], chunk.q[-1, 0]))
    except HaltError as error:
        halt = error.halt
    return chunks, calls, rest, dynamics.effort.steps, halt


def test_steps_in_c_come_in_groups(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each from the end of the one before; the ones that fail there are taken in Python from then on."""
    chunks, calls, rest, steps, halt = run(monkeypatch, 5000)
    assert chunks == [(0.0, 4096.0, 0.0, 4096.0), (4096.0, 5000.0, 4096.0, 5000.0)]
    assert calls == [(1.0, 4096, [0.0]), (1.0, 904, [4096.0])]
    assert (rest, steps, halt) == ([], 5000, None)
    chunks, calls, rest, steps, halt = run(monkeypatch, 10, stop=4)
    assert chunks == [(0.0, 4.0, 0.0, 4.0)]
    assert (rest, steps, len(calls)) == ([(4.0, [4.0] * N)], 4, 1)
    chunks, _, rest, steps, _ = run(monkeypatch, 10, stop=0)
    assert (chunks, rest, steps) == ([], [(0.0, [0.0] * N)], 0)
    chunks, calls, _, steps, halt = run(monkeypatch, 10, steps=7)
    assert (chunks, steps, halt.time) == ([(0.0, 7.0, 0.0, 7.0)], 7, 7.0)
    assert "limit of 7 steps" in halt.finding
    assert halt.remedy == "raise max_steps"
