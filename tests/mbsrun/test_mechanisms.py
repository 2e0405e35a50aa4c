"""Whole mechanisms through tape, C, compiler and faces: against Pinocchio, and by the laws of their derivatives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from mbsgen.families import list_functions, write_families
from mbsgen.request import Request
from mbsrun import Mechanism, load
from tests.random_trees import Pinocchio, law_forces, random_tree, values_of, with_laws, with_wrenches
from tests.sample import write_sample

SEEDS = [(1, False), (2, True), (3, False), (4, True)]
# Of sums of a few hundred products; the trees have six bodies of ordinary size, so conditioning adds little.
TOLERANCE = 1e-12


Build = Callable[..., tuple[Mechanism, Pinocchio, np.ndarray]]


@pytest.fixture(scope="module")
def build(tmp_path_factory: pytest.TempPathFactory) -> Build:
    """Return a function that generates some functions of a random tree, once for all tests."""

    @cache
    def generate(seed: int, runtime: bool, *functions: str) -> tuple[Mechanism, Pinocchio, np.ndarray]:
        """Return the tree's kernels, its Pinocchio model, and the matrix that u enters by."""
        tree = random_tree(seed, 6, runtime=runtime)
        parameters = {p.name: p.value for p in tree.parameters}
        assert bool(values_of(tree)) == runtime
        actuated = [i for i, body in enumerate(tree.bodies) if body.joint.actuated]
        families = write_families(tree, Request(functions=functions))
        folder = write_sample(tmp_path_factory.mktemp("tree"), f"tree {seed}", families, parameters)
        return load(folder), Pinocchio(tree), np.eye(6)[:, actuated]

    return generate


def draw_state(inputs: int, seed: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {
        "q": rng.uniform(-3, 3, 6),
        "qd": rng.normal(size=6),
        "qdd": rng.normal(size=6),
        "u": rng.normal(size=inputs),
    }


def assert_close(found: np.ndarray, expected: np.ndarray) -> None:
    np.testing.assert_allclose(found, expected, rtol=0, atol=TOLERANCE * max(1.0, np.abs(expected).max(initial=0)))


@pytest.mark.parametrize(("seed", "runtime"), SEEDS)
def test_the_residual_and_its_jacobians_are_pinocchios(seed: int, runtime: bool, build: Build) -> None:
    """Phi - B u; its derivatives by q and qd; M by qdd; -B by u."""
    k, pinocchio, B = build(seed, runtime, "impl")
    state = draw_state(B.shape[1], seed)
    q, qd, qdd, u = state.values()
    assert_close(k.impl(**state)["Phi"], pinocchio.residual(q, qd, qdd) - B @ u)
    jac, (by_q, by_qd) = k.jac_impl(**state), pinocchio.residual_derivatives(q, qd, qdd)
    for name, expected in {"q": by_q, "qd": by_qd, "qdd": pinocchio.mass_matrix(q), "u": -B}.items():
        assert_close(jac[f"jac_Phi_{name}"], expected)


@pytest.mark.parametrize(("seed", "runtime"), SEEDS)
def test_casadi_sees_the_same_function_to_second_order(seed: int, runtime: bool, build: Build) -> None:
    """Central differences of the exact gradient, in float64: (eps / step + step^2) with a step of 1e-5."""
    k, _, B = build(seed, runtime, "impl")
    state = draw_state(B.shape[1], seed)
    symbols = [ca.MX.sym(name, len(value)) for name, value in state.items()]
    unknown, weights = ca.veccat(*symbols), np.linspace(-1, 1, 6)
    cost = ca.dot(weights, k.casadi("impl")(*symbols))
    gradient = ca.Function("g", symbols, [ca.gradient(cost, unknown)])
    hessian = ca.Function("H", symbols, [ca.hessian(cost, unknown)[0]])(*state.values()).full()
    at, columns = np.concatenate(list(state.values())), []
    for i in range(len(at)):
        ends = [gradient(*np.split(at + sign * 1e-5 * np.eye(len(at))[i], [6, 12, 18])) for sign in (1, -1)]
        columns.append((ends[0] - ends[1]).full()[:, 0] / 2e-5)
    np.testing.assert_allclose(hessian, np.array(columns).T, rtol=0, atol=1e-8 * max(1.0, np.abs(hessian).max()))
    np.testing.assert_array_equal(hessian, hessian.T)


@pytest.mark.parametrize("runtime", [False, True])
def test_laws_and_open_wrenches_go_the_whole_way(runtime: bool, tmp_path: Path) -> None:
    """Residual, derivative by w, and accelerations that the residual vanishes at; the tree has no sensors."""
    tree = with_wrenches(with_laws(random_tree(6, 6, runtime=runtime)), 6)
    parameters = {p.name: p.value for p in tree.parameters}
    bare = replace(tree, sensors=())
    assert not {"sensors", "motion", "jacobian"} & set(list_functions(bare, Request()))
    k, explicit = (
        load(write_sample(tmp_path / name, name, write_families(bare, request), parameters))
        for name, request in (
            ("residual", Request(functions=("impl",), derivatives=1)),
            ("explicit", Request(functions=("exp1", "exp2"), derivatives=0)),
        )
    )
    peer = Pinocchio(tree)
    actuated = [i for i, body in enumerate(tree.bodies) if body.joint.actuated]
    state = draw_state(len(actuated), 6) | {"w": np.linspace(-4, 5, 9)}
    q, qd, qdd, u, w = state.values()
    forces = law_forces(tree, q, qd)
    forces[actuated] += u
    assert_close(k.impl(**state)["Phi"], peer.residual(q, qd, qdd, w) - forces)
    zero = peer.residual(q, qd, qdd, 0 * w)
    by_w = np.column_stack([peer.residual(q, qd, qdd, e) - zero for e in np.eye(9)])
    assert_close(k.jac_impl(**state)["jac_Phi_w"], by_w)
    assert_close(k.casadi("impl").jacobian()(*state.values(), 0)[4].full(), by_w)
    driven = {name: state[name] for name in ("q", "qd", "u", "w")}
    for kernel in ("exp1", "exp2"):
        found = k.impl(**(state | {"qdd": explicit(kernel, **driven)["qdd"]}))["Phi"]
        assert np.abs(found).max() <= 1e-10 * np.abs(forces).max()


def test_velocities_are_the_jacobian_times_the_rates(build: Build) -> None:
    """And the derivatives of positions along the motion."""
    k, pinocchio, _ = build(5, False, "sensors", "motion", "jacobian", "energy")
    state = draw_state(0, 5)
    q, qd = state["q"], state["qd"]
    motion, J = k.motion(q=q, qd=qd), k.jacobian(q=q)["J"]
    assert motion["v"].shape == motion["omega"].shape == (3, 1)
    assert_close(J @ qd, np.concatenate((motion["v"], motion["omega"]))[:, 0])
    assert_close(k.jac_sensors(q=q)["jac_position_q"], J[:3])
    energy = k.energy(q=q, qd=qd)
    assert_close(energy["kinetic"], [qd @ pinocchio.mass_matrix(q) @ qd / 2])
