"""Linear equations with numbers by hand: matrices, poles, what is 0, transfer functions, regulators, and equilibria."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsrun.kernel import ArgumentError
from mbsrun.linearisation import BalanceError, equations
from mbsrun.linearisation.equations import (
    Equilibrium,
    Excitation,
    Linearisation,
    Mode,
    _yield_to,
    balance,
    check_kernels,
    find_pose,
    settle,
)

Array = NDArray[np.float64]


def make(M: Any, C: Any, K: Any, F: Any, **given: Any) -> Linearisation:
    """Make equations of given matrices, with the coordinates as outputs."""
    mass = np.atleast_2d(np.array(M, dtype=float))
    d = len(mass)
    force = np.array(F, dtype=float).reshape(d, -1)
    none = np.zeros((d, 1))
    return Linearisation(
        equilibrium=Equilibrium(np.zeros(d), np.zeros(force.shape[1]), np.zeros(0), np.zeros(0)),
        freedoms=tuple(f"x{k}" for k in range(d)),
        inputs=tuple(f"u{k}" for k in range(force.shape[1])),
        driven=("y",),
        outputs=("x0",),
        M=mass,
        C=np.array(C, dtype=float).reshape(d, d),
        K=np.array(K, dtype=float).reshape(d, d),
        F=force,
        G=np.array(given.get("G", np.eye(1, 2 * d)), dtype=float),
        excitation=given.get("excitation", Excitation(none, none, none, np.zeros((1, 1)))),
    )


TWO = make([[2.0, 0.5], [0.5, 1.0]], [[0.3, 0.1], [-0.1, 0.2]], [[5.0, -1.0], [-2.0, 3.0]], [[1.0, 0.0], [2.0, 1.0]])


def test_accelerations_follow_from_the_matrices() -> None:
    """M s' + C s + K x = F u, of any state and input."""
    rng = np.random.default_rng(1)
    x, s, u = rng.standard_normal((3, 2))
    rates = TWO.A @ np.concatenate((x, s)) + TWO.B @ u
    assert rates[:2] == pytest.approx(s)
    assert TWO.M @ rates[2:] + TWO.C @ s + TWO.K @ x == pytest.approx(TWO.F @ u)


@pytest.mark.parametrize(
    ("damping", "stiffness", "poles"),
    [
        (0.4, 5.0, [-0.1 + 1j * np.sqrt(2.5 - 0.01)]),
        (6.0, 4.0, [-1.0, -2.0]),
        (0.0, -8.0, [-2.0, 2.0]),
        (0.0, 8.0, [2j]),
        (3.0, 0.0, [0.0, -1.5]),
        (-0.4, 5.0, [0.1 + 1j * np.sqrt(2.5 - 0.01)]),
    ],
)
def test_poles_of_one_freedom(damping: float, stiffness: float, poles: list[complex]) -> None:
    """m p^2 + c p + k = 0: in order of their size, of a pair the upper one."""
    found = make(2.0, damping, stiffness, 1.0)
    assert [mode.pole for mode in found.modes] == pytest.approx(poles)
    assert found.is_stable == all(np.real(p) < 0 for p in poles)
    for mode in found.modes:
        assert mode.shape == pytest.approx([1.0])
        assert mode.frequency == pytest.approx(abs(mode.pole) / 6.283185307179586)
        expected = -np.real(mode.pole) / abs(mode.pole) if mode.pole else 0.0
        assert mode.damping == pytest.approx(expected)
        assert all(np.copysign(1, x) == 1 for x in (mode.pole.real, mode.pole.imag) if x == 0)


def test_poles_of_rounding_are_0() -> None:
    """1e-6 of |A|: a double pole is found to the root of the rounding; real parts to 1e-12 of it."""
    for part, is_zero in ((0.9e-6, True), (1.1e-6, False)):
        length = np.sqrt(1 + 1 + 100)  # of A, with the entries 1, 1 and -10; the others are small
        found = make(np.eye(2), np.zeros((2, 2)), np.diag([-((part * length) ** 2), 10.0]), [1.0, 1.0])
        assert [mode.pole == 0 for mode in found.modes] == [is_zero, is_zero, False]
    for part, is_zero in ((0.9e-12, True), (1.1e-12, False)):
        length = np.linalg.norm(make(1.0, 0.0, 1.0, 1.0).A)
        (mode,) = make(1.0, -2 * part * length, 1.0, 1.0).modes
        assert (mode.pole.real == 0) == is_zero


def test_modes_that_inputs_or_outputs_miss_are_out_of_reach() -> None:
    """Two springs side by side: the input moves the first, and the output sees it."""
    found = make(np.eye(2), 0.1 * np.eye(2), np.diag([1.0, 4.0]), [1.0, 0.0])
    first, second = found.modes
    assert second.controllable < 1e-14
    assert second.observable < 1e-14
    size = np.linalg.norm(found.A) + np.linalg.norm(found.B)
    rest = found.A - first.pole * np.eye(4)
    reach = np.sqrt(np.linalg.eigvalsh(rest @ rest.conj().T + found.B @ found.B.T)[0])
    sight = np.sqrt(np.linalg.eigvalsh(rest.conj().T @ rest + found.G.T @ found.G)[0])
    assert first.controllable == pytest.approx(reach / size)
    assert first.observable == pytest.approx(sight / size)
    assert abs(first.shape[0]) == pytest.approx(1.0)
    assert abs(first.shape[1]) < 1e-12


def test_shapes_have_1_as_their_largest_entry() -> None:
    """K v = w^2 M v."""
    found = make([[2.0, 0.0], [0.0, 1.0]], np.zeros((2, 2)), [[6.0, -2.0], [-2.0, 3.0]], [1.0, 0.0])
    for mode in found.modes:
        assert np.abs(mode.shape).max() == pytest.approx(1.0)
        assert 1.0 in mode.shape.real.round(12)
        w = mode.pole.imag
        assert found.K @ mode.shape == pytest.approx(w**2 * found.M @ mode.shape)


def test_transfer_functions_are_of_the_dynamic_stiffness() -> None:
    """(K + p C + p^2 M)^-1 F at p = 2 pi i f; velocities are p times as large."""
    seen = replace(TWO, G=np.array([[1.0, 2.0, 0.0, 0.0], [0.0, 0.0, 0.0, 3.0]]))
    frequencies = np.array([0.0, 0.3, 2.0])
    for f, found in zip(frequencies, seen.respond(frequencies), strict=True):
        p = 2j * np.pi * f
        x = np.linalg.solve(TWO.K + p * TWO.C + p**2 * TWO.M, TWO.F)
        assert found == pytest.approx(np.array([x[0] + 2 * x[1], 3 * p * x[1]]))


def test_driven_joints_are_transmitted() -> None:
    """The outputs that move with them, less what their forces move."""
    rng = np.random.default_rng(2)
    m, c, k = rng.standard_normal((3, 2, 1))
    own = Excitation(m, c, k, np.array([[0.7]]))
    seen = replace(TWO, G=np.array([[1.0, 2.0, 0.0, 0.0]]), excitation=own)
    frequencies = np.array([0.0, 0.3, 2.0])
    for f, found in zip(frequencies, seen.transmit(frequencies), strict=True):
        p = 2j * np.pi * f
        x = -np.linalg.solve(TWO.K + p * TWO.C + p**2 * TWO.M, own.K + p * own.C + p**2 * own.M)
        assert found == pytest.approx(np.array([0.7 + x[0] + 2 * x[1]]))


def test_zeros_make_a_transfer_function_vanish() -> None:
    """Of two masses on a spring, the one that is pushed stands still where the other swings alone."""
    found = make(np.diag([1.0, 2.0]), np.zeros((2, 2)), [[9.0, -8.0], [-8.0, 8.0]], [[1.0, 0.0], [0.0, 1.0]])
    assert sorted(found.find_zeros(0, 0), key=np.imag) == pytest.approx([-2j, 2j])
    other = replace(found, G=np.eye(2, 4))
    assert len(other.find_zeros(1, 0)) == 0
    assert sorted(other.find_zeros(1, 1), key=np.imag) == pytest.approx([-3j, 3j])


def test_regulators_solve_riccatis_equation() -> None:
    """A'P + P A - P B R^-1 B'P + Q = 0, gains R^-1 B'P; weights are numbers, lists or matrices."""
    one = make(1.0, 0.0, 0.0, 1.0)
    assert one.regulate(4.0, 1.0) == pytest.approx(np.array([[0.5, np.sqrt(1 + 0.25)]]))
    assert one.regulate([4.0], [1.0, 0.25]) == pytest.approx(np.array([[0.5, np.sqrt(1 + 0.0625)]]))
    assert one.regulate(1.0) == pytest.approx(np.array([[1.0, np.sqrt(3.0)]]))
    R, Q = np.array([[2.0, 0.5], [0.5, 1.0]]), np.diag([1.0, 2.0, 0.0, 1.0])
    gains = TWO.regulate(R, Q)
    closed = TWO.A - TWO.B @ gains
    whole = np.kron(closed.T, np.eye(4)) + np.kron(np.eye(4), closed.T)
    P = np.linalg.solve(whole, -(Q + gains.T @ R @ gains).ravel()).reshape(4, 4)
    assert gains == pytest.approx(np.linalg.solve(R, TWO.B.T @ P), abs=1e-9)


@pytest.mark.parametrize(
    ("R", "Q", "finding"),
    [
        (0.0, 1.0, "R must be symmetric, without zero or negative eigenvalues"),
        (-1.0, 1.0, "R must be"),
        ([[1.0, 0.5], [0.0, 1.0]], 1.0, "R must be"),
        (1.0, -1e-8, r"Q must be symmetric, without negative eigenvalues"),
        (1.0, [1.0, 1.0, 1.0, -1.1e-9], "Q must be"),
        (1.0, [1.0, 1.0], r"Q has shape \(2,\); give a number, \(4,\) or \(4, 4\) of numbers"),
        ([1.0, np.nan], 1.0, "R has shape"),
        (np.inf, 1.0, "R has shape"),
    ],
)
def test_weights_are_refused(R: Any, Q: Any, finding: str) -> None:
    with pytest.raises(ArgumentError, match=finding):
        TWO.regulate(R, Q)


def test_weights_may_be_0_to_rounding() -> None:
    TWO.regulate(1.0, [1.0, 1.0, 1.0, -0.9e-9])
    TWO.regulate(1e-3, 0.0)


@pytest.mark.parametrize(("stiffness", "is_lost"), [(-1.0, True), (0.0, True), (1.0, False)])
def test_poles_that_no_input_reaches_are_named(stiffness: float, is_lost: bool) -> None:
    """They matter where they are not stable."""
    found = make(np.eye(2), 0.5 * np.eye(2), np.diag([1.0, stiffness]), [1.0, 0.0])
    if is_lost:
        with pytest.raises(BalanceError, match="no input reaches the poles"):
            found.regulate(1.0)
    else:
        assert found.regulate(1.0).shape == (1, 4)
    for reach, is_near in ((0.5e-9, True), (1e-7, False)):
        mode = Mode(1.0 + 0j, np.zeros(1, dtype=complex), reach, 1.0)
        weak = make(1.0, 0.0, -1.0, 1.0)
        object.__setattr__(weak, "modes", (mode,))
        if is_near:
            with pytest.raises(BalanceError, match=r"no input reaches the poles 1\+0j"):
                weak.regulate(1.0)
        else:
            weak.regulate(1.0)


def test_names_are_shown() -> None:
    assert repr(TWO) == "Linearisation(freedoms x0, x1; inputs u0, u1; outputs x0)"
    assert repr(replace(TWO, inputs=())) == "Linearisation(freedoms x0, x1; outputs x0)"


# --- equilibria -----------------------------------------------------------------------------------------------------


class Springs:
    """Kernels of masses on springs: K q + k q^3 + w = u on the actuated ones."""

    def __init__(self, K: Any, weight: Any, actuated: tuple[int, ...] = (), cubic: float = 0.0) -> None:
        self.K, self.weight, self.cubic = np.array(K, dtype=float), np.array(weight, dtype=float), cubic
        n = len(self.K)
        names = tuple(f"q{k}" for k in range(n))
        self.manifest: Any = SimpleNamespace(
            model="springs", loops=(), owners=(), driven=(), actuated=actuated, inputs=actuated, reads_time=False,
            coordinates=[SimpleNamespace(name=x) for x in names], positions=names, quaternions=(), pose=(),
            configuration=False, kernels=[SimpleNamespace(name=x) for x in ("impl", "jac_impl")], frames=(),
            independent=tuple(range(n)), dependent=(),
        )  # fmt: skip

    def describe(self, _: str) -> Any:
        """Return the inputs of the residual."""
        return SimpleNamespace(inputs=[SimpleNamespace(name=x) for x in ("q", "qd", "qdd", "u")])

    def __call__(self, name: str, q: Array, **given: Array) -> dict[str, Array]:
        S = np.eye(len(self.K))[:, list(self.manifest.actuated)]
        if name == "impl":
            return {"Phi": self.K @ q + self.cubic * q**3 + self.weight - S @ given["u"]}
        n = len(self.K)
        return {
            "jac_Phi_q": self.K + np.diag(3 * self.cubic * q**2), "jac_Phi_qd": np.zeros((n, n)),
            "jac_Phi_qdd": np.diag(np.arange(1.0, n + 1)), "jac_Phi_u": -S,
        }  # fmt: skip


def settle_springs(springs: Springs, q: list[float], u: Any = ()) -> Equilibrium:
    kernels: Any = springs
    return settle(kernels, np.array(q), np.array(u, dtype=float))


def balance_springs(springs: Springs, q: list[float], given: dict[int, float] | None = None) -> Equilibrium:
    kernels: Any = springs
    return balance(kernels, np.array(q), given or {})


def test_inputs_of_least_norm_keep_a_pose() -> None:
    """The free ones; given ones stay."""
    springs = Springs(np.diag([2.0, 3.0]), [1.0, -7.0], actuated=(0, 1))
    assert balance_springs(springs, [1.0, 2.0]).u == pytest.approx([3.0, -1.0])
    assert balance_springs(springs, [1.0, 2.0], {1: -1.0}).u == pytest.approx([3.0, -1.0])
    with pytest.raises(BalanceError, match=r"a force of 0\.5 along q1 is not balanced"):
        balance_springs(springs, [1.0, 2.0], {1: -0.5})


@pytest.mark.parametrize(("size", "is_one"), [(0.9e-8, True), (1.1e-8, False)])
def test_forces_of_rounding_are_balanced(size: float, is_one: bool) -> None:
    """1e-8, or of the largest force where that is above 1."""
    for weight, q, force in (([0.0, 0.0], [0.0, size], size), ([100.0, 0.0], [0.0, 100 * size], 100 * size)):
        springs = Springs(np.eye(2), weight, actuated=(0,))
        if is_one:
            assert balance_springs(springs, q).u == pytest.approx([weight[0]])
        else:
            with pytest.raises(BalanceError, match=f"a force of {force:.3g} along q1".replace("+", r"\+")):
                balance_springs(springs, q)


def test_newtons_method_settles() -> None:
    """Where it hangs: K q + k q^3 + w = u, from afar by steps of 0.3."""
    found = settle_springs(Springs([[3.0, -1.0], [-1.0, 2.0]], [4.0, -2.0], (1,)), [5.0, -5.0], [1.0])
    assert found.q == pytest.approx(np.linalg.solve([[3.0, -1.0], [-1.0, 2.0]], [-4.0, 3.0]), abs=1e-9)
    assert found.u.tolist() == [1.0]
    found = settle_springs(Springs(np.eye(1), [-10.0], cubic=1.0), [0.0])
    assert found.q == pytest.approx([2.0], abs=1e-9)


def test_steps_to_an_equilibrium_are_0_3_at_most(monkeypatch: pytest.MonkeyPatch) -> None:
    places: list[float] = []
    monkeypatch.setattr(equations, "normalise", lambda q, _: (places.append(float(q[0])), q)[1])  # type: ignore[func-returns-value]
    settle_springs(Springs(np.eye(1), [0.0]), [1.0])
    assert places == pytest.approx([1.0, 0.7, 0.4, 0.1, 0.0, 0.0], abs=1e-15)


def test_poses_that_nothing_keeps_are_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """After a hundred steps, which are along what no stiffness balances."""
    places: list[Array] = []
    monkeypatch.setattr(equations, "normalise", lambda q, _: (places.append(q.copy()), q)[1])  # type: ignore[func-returns-value]
    with pytest.raises(BalanceError, match="no equilibrium was found near the pose"):
        settle_springs(Springs(np.diag([1.0, 0.0]), [0.0, 4.0]), [0.0, 0.0])
    assert len(places) == 100
    assert np.diff([q[1] for q in places]) == pytest.approx(np.full(99, -0.3))
    assert not np.array([q[0] for q in places]).any()


def test_what_no_stiffness_balances_is_yielded_to_from_a_tenth_of_all(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[list[float]] = []

    def note(left: Array, _: Array) -> Array:
        asked.append(left.tolist())
        return np.zeros(len(left))

    monkeypatch.setattr(equations, "_yield_to", note)
    monkeypatch.setattr(equations, "ITERATIONS", 1)
    for part in (0.99, -0.99, 1.01, -1.01):
        asked.clear()
        with pytest.raises(BalanceError):
            settle_springs(Springs(np.diag([2.0, 0.0]), [10.0, part]), [0.0, 0.0])
        assert asked == ([[0.0, part]] if abs(part) > 1 else [])


def test_poses_yield_by_the_longest_step() -> None:
    """Along the accelerations of the forces that are left: -M^-1 f, of size 0.3."""
    assert _yield_to(np.array([2.0, -3.0]), np.diag([1.0, 3.0])) == pytest.approx([-0.3, 0.15])


def test_functions_that_are_missing_are_named() -> None:
    springs: Any = Springs(np.eye(1), [0.0])
    check_kernels(springs)
    springs.manifest.kernels = []
    with pytest.raises(ArgumentError, match="springs was generated without impl, jac_impl"):
        check_kernels(springs)
    check_kernels(springs, ())
    springs.manifest.reads_time = True
    with pytest.raises(ArgumentError, match="depend on the time t"):
        check_kernels(springs, ())


def test_poses_have_their_given_coordinates() -> None:
    springs: Any = Springs(np.eye(3), np.zeros(3))
    assert find_pose(springs, {"q1": 2.0, "q0": -1.0}).tolist() == [-1.0, 2.0, 0.0]
    springs.manifest.pose = (4.0, 5.0, 6.0)
    assert find_pose(springs, {"q1": 2.0}).tolist() == [4.0, 2.0, 6.0]
    start = np.array([7.0, 8.0, 9.0])
    assert find_pose(springs, {"q2": 2.0}, start).tolist() == [7.0, 8.0, 2.0]
    assert start.tolist() == [7.0, 8.0, 9.0]
