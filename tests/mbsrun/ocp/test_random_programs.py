"""Random programs: every backend computes what CasADi does of the same sums, written once more term by term."""

from __future__ import annotations

from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy import sparse

from mbsrun.ocp.evaluation.backends import condensation
from mbsrun.ocp.evaluation.backends.numpy import NumpyProgram
from mbsrun.ocp.evaluation.backends.prepared import Prepared
from mbsrun.ocp.evaluation.backends.stacked import StackedProgram
from mbsrun.ocp.evaluation.stages.binding import Evaluator, Tables
from mbsrun.ocp.evaluation.stages.building import build
from tests.mbsrun.ocp.random_programs import Drawn, at_random, draw, with_copies
from tests.mbsrun.ocp.stages.stage_functions import compare
from tests.mbsrun.peer import Peer, double_integrator

SEEDS = range(16)
NEAR = 1e-12  # relative to the largest entry: sums of some hundred products


@cache
def plant() -> Peer:
    return double_integrator()


@cache
def known(seed: int) -> tuple[Drawn, ca.Function]:
    """Draw a program, and write its terms, cost, gradient, rows, Jacobian and Hessian of f + lam' g in CasADi."""
    drawn = draw(seed)
    x, p = ca.SX.sym("x", drawn.program.variables), ca.SX.sym("p", drawn.program.parameters)
    s, lam = ca.SX.sym("s"), ca.SX.sym("lam", drawn.program.constraints)
    terms, f, g = drawn.express(x, p)
    H = ca.hessian(s * f + ca.dot(lam, g), x)[0]
    return drawn, ca.Function("whole", [x, p, s, lam], [terms, f, ca.gradient(f, x), g, ca.jacobian(g, x), H])


def evaluate(seed: int) -> tuple[Drawn, tuple[Any, ...], list[Any]]:
    """Return a program, a point with multipliers, and all results there."""
    drawn, function = known(seed)
    rng = np.random.default_rng(1000 + seed)
    x, p = at_random(drawn.program, rng)
    at = x, p, 0.7, rng.uniform(-1, 1, drawn.program.constraints)
    return drawn, at, [np.squeeze(part.full()) for part in function.call([*map(ca.DM, at)])]


def near(found: Any, wanted: Any) -> bool:
    found = np.asarray(found.toarray() if sparse.issparse(found) else found).reshape(np.shape(wanted))
    return bool(np.abs(found - wanted).max(initial=0.0) <= NEAR * (1 + np.abs(wanted).max(initial=0.0)))


@pytest.mark.parametrize("seed", SEEDS)
def test_numpy_computes_the_sums(seed: int) -> None:
    drawn, (x, p, s, lam), (terms, f, gradient, g, J, H) = evaluate(seed)
    ours = NumpyProgram(drawn.program, plant())
    assert near(ours.terms(x, p), terms)
    assert near(ours.objective(x, p), f)
    assert near(ours.gradient(x, p), gradient)
    assert near(ours.constraint(x, p), g)
    assert near(ours.jacobian(x, p), J)
    assert near(ours.hessian(x, p, s, lam), np.triu(H))
    jacobian, hessian = ours.count_nonzeros()
    assert jacobian == ours.jacobian(x, p).nnz >= np.count_nonzero(J)
    assert hessian == ours.hessian(x, p, s, lam).nnz >= np.count_nonzero(np.triu(H))


@pytest.mark.parametrize("seed", SEEDS)
def test_casadi_computes_the_sums(seed: int) -> None:
    drawn, at, (terms, f, gradient, g, J, H) = evaluate(seed)
    ours, (x, p, s, lam) = condensation.build(drawn.program, plant()), (ca.DM(part) for part in at)
    assert near(ours.terms(x, p).full(), terms)
    assert near(ours.objective(x, p).full(), f)
    assert near(ours.gradient.call([x, p])[-1].full(), gradient)
    assert near(ours.constraint(x, p).full(), g)
    assert near(ours.jacobian.call([x, p])[-1].full(), J)
    assert near(ours.hessian.call([x, p, s, lam])[-1].full(), np.triu(H))


@pytest.mark.parametrize("seed", SEEDS)
def test_many_points_are_evaluated_at_once(seed: int) -> None:
    drawn, function = known(seed)
    rng, program = np.random.default_rng(2000 + seed), drawn.program
    x, p = (np.array(part) for part in zip(*(at_random(program, rng) for _ in range(3)), strict=True))
    ours = StackedProgram(Prepared(program, plant()), 3)
    found = ours.evaluate(x, p)
    for k in range(3):
        terms, _, gradient, g, J, _ = (part.full() for part in function(x[k], p[k], 0, 0))
        slopes = ours.pattern.copy()
        slopes.data = found.slopes[k]
        assert near(found.terms[k][:, None], terms)
        assert near(found.gradient[k][:, None], gradient)
        assert near(found.rows[k][:, None], g)
        assert near(slopes, J)


@pytest.mark.parametrize("are_copied", [False, True])
@pytest.mark.parametrize("seed", SEEDS)
def test_tables_of_stages_compute_the_sums(seed: int, are_copied: bool) -> None:
    """As the program that NumPy evaluates, in C: values, Jacobian and Hessian, where states are copied or not."""
    drawn, rng = draw(seed), np.random.default_rng(3000 + seed)
    program = (with_copies(drawn, rng) if are_copied else drawn).program
    x, p = at_random(program, rng)
    found = compare(Evaluator(Tables(build(program, plant()), plant()), p), program, plant(), x, p, rng)
    assert max(found.values, found.slopes, found.curvatures) < NEAR
