"""The hand-made arm against the reference: values of Pinocchio and of a 50-digit code that agree."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.mbsrun.peer_arm import M, N, peer_arm

REFERENCE = json.loads((Path(__file__).parents[1] / "reference" / "seed_arm_docquier.json").read_text("utf-8"))
ARM = peer_arm()


@pytest.fixture(params=REFERENCE["states"], ids=lambda state: f"q1={state['q'][0]}")
def state(request: pytest.FixtureRequest) -> Any:
    return request.param


def test_residual(state: Any) -> None:
    """Phi(q, qd, qdd) with no input is the inverse dynamics: 1e-12 of its size."""
    Phi = ARM("impl", q=state["q"], qd=state["qd"], qdd=state["qdd"], u=np.zeros(M))["Phi"]
    assert Phi == pytest.approx(np.array(state["exact50"]["tau_id"], dtype=float), rel=1e-12, abs=1e-12)


def test_mass_matrix(state: Any) -> None:
    """M is the residual's Jacobian by the accelerations."""
    jacobian = ARM("jac_impl", q=state["q"], qd=np.zeros(N), qdd=np.zeros(N), u=np.zeros(M))["jac_Phi_qdd"]
    assert jacobian == pytest.approx(np.array(state["exact50"]["M"], dtype=float), rel=1e-12, abs=1e-12)


def test_structural_zeros() -> None:
    """30 + 35 + 34 + 4: no joint feels q1; M56 = 0 and dPhi6/dqd6 = 0, since the pendulum's inertia is diagonal."""
    jacobian = ARM.casadi("jac_impl")
    assert [jacobian.nnz_out(i) for i in range(4)] == [30, 35, 34, 4]


def test_batches_are_states_side_by_side() -> None:
    rng = np.random.default_rng(0)
    q = rng.uniform(-1, 1, (3, N))
    frames = ARM("frames", q=q)
    for i in range(3):
        one = ARM("frames", q=q[i])
        assert np.array_equal(frames["p"][i], one["p"])
        assert np.array_equal(frames["R"][i], one["R"])
