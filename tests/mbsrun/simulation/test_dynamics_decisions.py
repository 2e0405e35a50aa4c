"""Equations of motion in each formulation by hand: accelerations, slopes, what is counted, and masses that are lost."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen.roles import Role
from mbsrun.kernel import KernelError, Place
from mbsrun.simulation.dynamics import Dynamics, SingularError, find_mass_matrix
from mbsrun.simulation.formulation import Formulation

Array = NDArray[np.float64]
M = np.array([[2.0, 0.5], [0.5, 1.0]])
C, K = np.array([[0.1, 0.2], [0.3, 0.4]]), np.array([[5.0, 1.0], [-1.0, 4.0]])
S, W = np.array([[1.0], [2.0]]), np.array([[0.5], [-1.0]])  # of the input u and of the wrench w
Q, QD, QDD = (
    np.array([[0.2, -0.3], [1.0, 2.0]]),
    np.array([[1.0, 0.5], [-1.0, 3.0]]),
    np.array([[4.0, 5.0], [6.0, 7.0]]),
)
V = np.array([[2.0, 3.0], [-1.0, 4.0]])


class Linear:
    """Kernels of M qdd + C qd + K q - S u - W w - J' lam, by name; `taken` is what each takes."""

    def __init__(self, *, fails: bool = False, kernels: tuple[str, ...] = ("exp2",)) -> None:
        self.calls: list[tuple[str, tuple[str, ...]]] = []
        self.fails = fails
        joints = [SimpleNamespace(name=name) for name in ("a", "b")]
        self.manifest: Any = SimpleNamespace(
            coordinates=joints, positions=("a", "b"), actuated=(0,), driven=(), configuration=(), owners=(0,),
            find=lambda name: name if name in kernels else None, kernel=self.describe,
        )  # fmt: skip

    def describe(self, name: str) -> Any:
        taken = {"q": 1, "qd": 1, "u": 1, "w": 1, "odd": 0, "a": 0}
        if "impl" in name or "semi" in name:
            taken |= {"qdd": 1, "lam": 1}
        inputs = [
            SimpleNamespace(name=x, nnz=nnz, role=Role.ACCELERATION if x == "qdd" else Role.VELOCITY)
            for x, nnz in taken.items()
        ]
        mass = ("M", Role.MASS_MATRIX) if name == "semi" else ("jac_Phi_qdd", Role.RESULT)
        every = (("Phi", Role.RESULT, None), ("jac_Phi_q", Role.RESULT, "q"), (*mass, "qdd"))
        outputs = [SimpleNamespace(name=x, role=role, by=by) for x, role, by in every]
        own = SimpleNamespace(inputs=inputs, outputs=outputs)
        own.taking = lambda role: next((x for x in inputs if x.role is role), None)
        return own

    def __call__(self, name: str, **given: Any) -> dict[str, Array]:
        self.calls.append((name, tuple(sorted(given))))
        if self.fails:
            raise KernelError(name, Place("a", None, 1), 0)
        q, qd, u, w = (np.atleast_2d(given[x]) for x in ("q", "qd", "u", "w"))
        rest = qd @ C.T + q @ K.T - u @ S.T - w @ W.T
        direct = -np.linalg.solve(M, rest.T).T
        n = len(q)
        matrices = {
            "jac_qdd_q": -np.linalg.solve(M, K), "jac_qdd_qd": -np.linalg.solve(M, C), "M": M,
            "jac_Phi_q": K, "jac_Phi_qd": C, "jac_Phi_qdd": M,
        }  # fmt: skip
        blocks = {key: np.tile(x, (n, 1, 1)) for key, x in matrices.items()} | {"qdd": direct, "Phi": rest}
        if "qdd" in given:
            blocks["Phi"] = np.atleast_2d(given["qdd"]) @ M.T + rest - np.atleast_2d(given.get("lam", np.zeros((n, 2))))
        return {key: x if np.ndim(given["q"]) == 2 else x[0] for key, x in blocks.items()}

    def attempt(self, name: str, **given: Any) -> tuple[dict[str, Array], None]:
        self.calls.append((name, tuple(sorted(given))))
        return {"qdd": self(name, **given)["qdd"]}, None


ACCELERATION = -np.linalg.solve(M, (QD @ C.T + Q @ K.T - V[:, :1] @ S.T - V[:, 1:] @ W.T).T).T


def make(formulation: Formulation, **given: Any) -> tuple[Dynamics, Linear]:
    kernels: Any = Linear(**given)
    return Dynamics(kernels, formulation), kernels


@pytest.mark.parametrize("formulation", Formulation)
def test_accelerations_balance_the_forces_in_every_formulation(formulation: Formulation) -> None:
    """Of one state and of many; each state counts."""
    dynamics, _ = make(formulation)
    assert dynamics.accelerations(Q, QD, V) == pytest.approx(ACCELERATION)
    assert dynamics.effort.evaluations == 2
    assert dynamics.accelerations(Q[0], QD[0], V[0]) == pytest.approx(ACCELERATION[0])
    assert dynamics.effort.evaluations == 3
    assert (dynamics.size, dynamics.places, dynamics.forces_count) == (2, 2, 1)


@pytest.mark.parametrize("formulation", Formulation)
def test_slopes_are_derivatives_in_every_formulation(formulation: Formulation) -> None:
    dynamics, _ = make(formulation)
    by_q, by_qd = dynamics.slopes(Q, QD, V)
    assert by_q == pytest.approx(np.tile(-np.linalg.solve(M, K), (2, 1, 1)))
    assert by_qd == pytest.approx(np.tile(-np.linalg.solve(M, C), (2, 1, 1)))
    assert dynamics.effort.jacobians == 2
    parts = dynamics.stiffnesses(Q, QD, QDD, V)
    assert dynamics.effort.jacobians == 4
    solved = np.linalg.inv(M) if formulation.evaluated.is_direct else np.eye(2)
    for found, exact in zip(parts, (K, C, M), strict=True):
        assert found == pytest.approx(np.tile(solved @ exact, (2, 1, 1)))
    residual = dynamics.residual(Q, QD, QDD, V)
    assert residual == pytest.approx((QDD - ACCELERATION) @ (solved @ M).T)
    by_inputs = dynamics.input_slopes(Q, QD, QDD, V)
    assert by_inputs == pytest.approx(np.tile(-solved @ np.hstack((S, W)), (2, 1, 1)))


def test_multipliers_count_where_equations_take_them() -> None:
    dynamics, kernels = make(Formulation.IMPL)
    lam = np.array([[1.0, 2.0], [3.0, 4.0]])
    with_loops = dynamics.residual(Q, QD, QDD, V, lam)
    assert with_loops == pytest.approx(dynamics.residual(Q, QD, QDD, V) - lam)
    assert kernels.calls[0][1] == ("lam", "q", "qd", "qdd", "u", "w")
    assert kernels.calls[1][1] == ("q", "qd", "qdd", "u", "w")
    assert dynamics.input_slopes(Q, QD, QDD, V, lam) == pytest.approx(np.tile(-np.hstack((S, W)), (2, 1, 1)))
    Phi, *blocks = dynamics.linearise(Q, QD, QDD, V)
    assert Phi == pytest.approx((QDD - ACCELERATION) @ M.T)
    assert [x[1].tolist() for x in blocks] == [K.tolist(), C.tolist(), M.tolist()]


def test_blocks_without_an_entry_are_0() -> None:
    dynamics, _ = make(Formulation.IMPL)
    found = dynamics._take({"jac_Phi_qd": np.ones((2, 2, 2))}, "Phi", ("q", "qd"), Q)
    assert [x.tolist() for x in found] == [np.zeros((2, 2, 2)).tolist(), np.ones((2, 2, 2)).tolist()]


def test_rates_are_velocities_without_quaternions_and_a_kernels_with_them() -> None:
    dynamics, kernels = make(Formulation.EXP2)
    assert dynamics.rates(Q, QD) is QD
    by_q, by_qd = dynamics.rate_slopes(Q, QD)
    assert (by_q.shape, by_q.any(), by_qd.tolist()) == ((2, 2, 2), False, [np.eye(2).tolist()] * 2)
    kernels.manifest.configuration = ("a",)
    turned: Any = lambda name, **_: {"rate": "r", "jac_rate_q": "rq", "jac_rate_qd": "rqd"} if "rate" in name else {}  # noqa: E731
    own = Dynamics(SimpleNamespace(manifest=kernels.manifest, __call__=turned), Formulation.EXP2)  # type: ignore[arg-type]
    object.__setattr__(own, "kernels", _Called(kernels.manifest, turned))
    assert own.rates(Q, QD) == "r"  # type: ignore[comparison-overlap]
    assert own.rate_slopes(Q, QD) == ("rq", "rqd")  # type: ignore[comparison-overlap]


class _Called:
    def __init__(self, manifest: Any, call: Any) -> None:
        self.manifest, self.call = manifest, call

    def __call__(self, name: str, **given: Any) -> Any:
        return self.call(name, **given)


def test_accelerations_that_are_asked_for_later_are_no_effort() -> None:
    """By a kernel that solves for them, or else by the formulation; NaN where it fails."""
    dynamics, kernels = make(Formulation.SEMI)
    t = np.zeros(2)
    assert dynamics.find_accelerations(t, Q, QD, V) == pytest.approx(ACCELERATION)
    assert kernels.calls[0] == ("exp2", ("q", "qd", "u", "w"))
    for formulation in (Formulation.SEMI, Formulation.IMPL):
        dynamics, kernels = make(formulation, kernels=("impl",))
        assert dynamics.find_accelerations(t, Q, QD, V) == pytest.approx(ACCELERATION)
        assert dynamics.effort.evaluations == 0
        dynamics, _ = make(formulation, kernels=("impl",), fails=True)
        assert np.isnan(dynamics.find_accelerations(t, Q, QD, V)).all()
    dynamics, _ = make(Formulation.EXP2)
    lam, tau = dynamics.forces(t, Q, QD, V)
    assert (lam.shape, tau.shape) == ((2, 0), (2, 0))


@pytest.mark.parametrize(("name", "found"), [("semi", "M"), ("jac_impl", "jac_Phi_qdd")])
def test_the_mass_matrix_is_a_result_or_the_slope_by_accelerations(name: str, found: str) -> None:
    assert find_mass_matrix(Linear().describe(name)).name == found


# --- masses that are lost -------------------------------------------------------------------------------------------


def test_linear_systems_are_solved_where_every_pivot_keeps_its_digits() -> None:
    """Below n 1000 epsilon of the diagonal, the joint is named whose pivot is lost first."""
    dynamics, _ = make(Formulation.SEMI)
    many = np.stack((M, 2 * M))
    assert dynamics.solve(many, np.ones((2, 2))) == pytest.approx(
        np.array([np.linalg.solve(M, [1, 1]), np.linalg.solve(2 * M, [1, 1])])
    )
    limit = 2 * 1e3 * np.finfo(float).eps
    for pivot, name in ((1.2 * limit, None), (0.8 * limit, "b"), (0.0, "b"), (-1.0, "b")):
        matrix = np.array([[1.0, 1.0], [1.0, 1.0 + pivot]])
        if name is None:
            assert np.isfinite(dynamics.solve(matrix, np.ones(2))).all()
        else:
            with pytest.raises(SingularError, match=f"at joint {name}$"):
                dynamics.solve(matrix, np.ones(2))
    for matrix in (np.array([[0.0, 0.0], [0.0, 1.0]]), np.array([[-1.0, 0.0], [0.0, 1.0]])):
        with pytest.raises(SingularError, match=r"at joint a$"):
            dynamics.solve(matrix, np.ones(2))


def test_the_factor_of_chosen_joints_has_their_entries_alone() -> None:
    dynamics, _ = make(Formulation.SEMI)
    whole = np.array([[4.0, 1.0], [1.0, 9.0]])
    assert dynamics.factorise(whole, np.array([1])).tolist() == [[3.0]]
    assert dynamics.factorise(whole[None], np.array([0]))[0].tolist() == [[2.0]]
    L = dynamics.factorise(whole, np.array([0, 1]))
    assert pytest.approx(whole) == L @ L.T
    lost = np.array([[4.0, 1.0], [1.0, 0.0]])
    with pytest.raises(SingularError, match=r"at joint b$"):
        dynamics.factorise(lost, np.array([1]))
    assert dynamics.factorise(lost, np.array([0])).tolist() == [[2.0]]
    assert dynamics.find_pivot(whole) == "b"
