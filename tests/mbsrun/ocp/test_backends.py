"""A program is data: two backends make the same functions of it, and its stages agree with its KKT matrix."""

from __future__ import annotations

import ast
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy import sparse

import mbsrun
from mbsgen.expressions import FUNCTIONS, parse
from mbsrun.ocp.evaluation.backends import condensation
from mbsrun.ocp.evaluation.backends import numpy as in_numpy
from mbsrun.ocp.evaluation.backends.evaluations import FormulaEvaluation
from mbsrun.ocp.evaluation.backends.places import make_function
from mbsrun.ocp.ground.functions import Formula, Input
from mbsrun.ocp.ground.program import COMMON, Block, Program
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.problem.problem import Form, Problem, Representation
from mbsrun.ocp.transcription.transcription import transcribe
from tests.mbsrun.ocp.programs import rich
from tests.mbsrun.peer import Peer, double_integrator

SHOOTING = {"form": Form.SHOOTING, "horizon": 0.2}
WAYS: dict[str, tuple[Representation, bool, dict[str, Any]]] = {
    **{r.value: (r, i % 2 == 0, {}) for i, r in enumerate(Representation)},
    "integral": (Representation.IMPL, False, {"form": Form.INTEGRAL}),
    "shooting by the scheme": (Representation.IMPL, False, {**SHOOTING, "steps": 2}),
    "shooting by rk4": (Representation.EXP2_O, False, {**SHOOTING, "integrator": "rk4", "steps": 2}),
}


def choose(reach: Problem, way: str) -> Problem:
    """Ask for everything, in one of the ways; every other representation with a free horizon."""
    representation, free, changes = WAYS[way]
    return replace(rich(reach, representation, Family.RADAU, free), **changes)


@pytest.fixture
def compiler(requires: Callable[[str], str]) -> None:
    """Newton's method factorises in C."""
    requires("cc")


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("way", ["IMPL", "EXP1-O", "EXP1-A", "shooting by the scheme", "shooting by rk4"])
def test_numpy_and_casadi_make_the_same_functions(
    arm: Peer, reach: Problem, way: str, rng: np.random.Generator
) -> None:
    """Values and derivatives to rounding; NumPy's patterns hold all nonzeros of CasADi's."""
    problem = choose(reach, way)
    transcription = transcribe(problem, arm)
    ours, theirs = (backend.build(transcription.program, arm) for backend in (in_numpy, condensation))
    x, p = rng.uniform(0.5, 1, theirs.variables), transcription.parameters(problem)
    lam = rng.uniform(-1, 1, theirs.constraints)
    pairs = {
        "completion": (ours.complete(x), theirs.complete(x)),
        "terms": (ours.terms(x, p), theirs.terms(x, p).full().ravel()),
        "objective": (ours.objective(x, p), float(theirs.objective(x, p))),
        "gradient": (ours.gradient(x, p), theirs.gradient(x, p)[1].full().ravel()),
        "constraint": (ours.constraint(x, p), theirs.constraint(x, p).full().ravel()),
        "jacobian": (ours.jacobian(x, p).toarray(), theirs.jacobian(x, p).full()),
        "hessian": (ours.hessian(x, p, 0.7, lam).toarray(), theirs.hessian(x, p, 0.7, lam).full()),
    }
    for name, (found, expected) in pairs.items():
        scale = np.abs(expected).max()
        assert np.abs(found - expected).max() <= 1e-12 * scale, name
    if not transcription.program.solved:
        assert ours.jacobian(x, p).nnz == theirs.jacobian.nnz_out(0)
        assert ours.hessian(x, p, 0.7, lam).nnz == theirs.hessian.nnz_out(0)


@pytest.mark.parametrize("text", ["(s0*a0)**2 + a1", "exp(s0*a0)*a1 + s0*sin(a1)", "s0*a0*a1"])
@pytest.mark.parametrize("places", [1, 3])
def test_derivatives_that_a_number_makes_zero_keep_their_places(
    text: str, places: int, rng: np.random.Generator
) -> None:
    """CasADi drops products with a number that is 0, such as the time at the start; other entries must not move up."""
    names = {"a0": ("a", 0), "a1": ("a", 1), "s0": ("s", 0)}
    formula = Formula((parse(text),), names, (Input("a", 2),), data=Input("s", 1))
    at, columns = np.arange(places), np.arange(2 * places).reshape(2, places)
    blocks = tuple(
        Block(formula, (columns,), row[None], at, data=np.full((1, places), value))
        for row, value in ((at, 0.0), (places + at, 0.7))
    )
    nothing = sparse.csc_array((2 * places, 2 * places))
    program = Program(nothing, (nothing,), blocks)
    ours, theirs = (backend.build(program, double_integrator()) for backend in (in_numpy, condensation))
    x, lam, p = rng.uniform(0.5, 1, 2 * places), rng.uniform(0.5, 1, 2 * places), np.ones(1)
    assert theirs.constraint(x, p).full().ravel() == pytest.approx(ours.constraint(x, p))
    assert theirs.jacobian(x, p).full() == pytest.approx(ours.jacobian(x, p).toarray())
    assert theirs.hessian(x, p, 0.7, lam).full() == pytest.approx(ours.hessian(x, p, 0.7, lam).toarray())


TEXTS = [f"{name}(a0*b0 + 0.3)" for name, count in FUNCTIONS.items() if count == 1] + [
    "atan2(a0 + b0*a1, a1 - 2)",
    "-a0**3/(b0 - a1**2) + pi*a1**-2",
    "(a0 + a1)**0 + a0**1",
]


@pytest.mark.parametrize("text", TEXTS)
def test_jets_are_the_derivatives_of_expressions(text: str, rng: np.random.Generator) -> None:
    """Values, first and second derivatives against CasADi's at random places, with its patterns."""
    inputs = (Input("a", 2), Input("b", 1))
    names = {f"{part.kind}{i}": (part.kind, i) for part in inputs for i in range(part.size)}
    formula, plant = Formula((parse(text),), names, inputs), double_integrator()
    given = [rng.uniform(0.1, 0.5, (4, part.size)) for part in inputs]
    x = ca.SX.sym("x", 3)
    expression = make_function(formula, plant)(x[:2], x[2])
    jacobian, hessian = ca.jacobian(expression, x), ca.hessian(expression, x)[0]
    exact = ca.Function("exact", [x], [expression, jacobian, hessian])
    found = FormulaEvaluation(formula, plant, 4)
    J = np.zeros((4, 3))
    H = np.zeros((4, 3, 3))
    starts = (0, 2)
    for start, pattern, values in zip(starts, found.jacobian_patterns, found.jacobian(given), strict=True):
        J[:, start + pattern.col] = values
    corners = [(i, j) for i in starts for j in starts]
    second = found.hessian(given, np.ones((4, 1)))
    for (i, j), pattern, values in zip(corners, found.hessian_patterns, second, strict=True):
        H[:, i + pattern.row, j + pattern.col] = values
    for k in range(4):
        f, g, h = (part.full() for part in exact(np.concatenate([part[k] for part in given])))
        assert found.value(given)[k] == pytest.approx(f.ravel(), rel=1e-13)
        assert J[k] == pytest.approx(g.ravel(), rel=1e-12, abs=1e-13)
        assert H[k] == pytest.approx(h, rel=1e-11, abs=1e-12)
    assert sum(pattern.row.size for pattern in found.jacobian_patterns) == jacobian.nnz()
    assert sum(pattern.row.size for pattern in found.hessian_patterns) <= hessian.nnz()


# --- stages --------------------------------------------------------------------------------------------------------


def read_pattern(program: Program, arm: Peer) -> tuple[sparse.csr_array, np.ndarray]:
    """Patterns of the whole program: Jacobian, and rows and columns of the Hessian's upper triangle."""
    functions = condensation.build(replace(program, solved=()), arm)
    jacobian = sparse.csr_array(ca.DM(functions.jacobian.sparsity_out(0), 1.0).sparse())
    return jacobian, np.array(functions.hessian.sparsity_out(0).get_triplet())


@pytest.mark.parametrize("way", WAYS)
def test_stages_order_the_kkt_matrix(arm: Peer, reach: Problem, way: str) -> None:
    """It is block tridiagonal, except for variables that all stages share; inner equations read only their interval.

    A row reads its own stage and the next one, none before. There are as many inner equations as inner variables. The
    rows that propagate the state are the next state minus a function of the interval.
    """
    program = transcribe(choose(reach, way), arm).program
    stages, (J, upper) = program.stages, read_pattern(program, arm)
    assert stages is not None
    stage = stages.variables(program.variables)
    assert list(np.flatnonzero(stage == COMMON)) == list(stages.common)
    coupled = stage[upper][:, (stage[upper] != COMMON).all(axis=0)]
    assert np.abs(coupled[0] - coupled[1]).max() == 1
    rows, cols = J.tocoo().coords
    assert set((stage[cols] - stages.rows[rows])[stage[cols] != COMMON]) == {0, 1}
    assert stages.inner.shape == stages.equations.shape
    for k in range(len(stages.inputs)):
        own = np.concatenate((stages.states[k], stages.inputs[k], stages.inner[k].ravel(), stages.common))
        assert np.isin(J[stages.equations[k].ravel()].tocoo().coords[1], own).all()
        carried = J[stages.continuity[k]]
        assert np.array_equal(carried.toarray()[:, stages.states[k + 1]], np.eye(carried.shape[0]))
        assert list(np.setdiff1d(carried.tocoo().coords[1], own)) == list(stages.states[k + 1])


def test_equations_of_explicit_methods_are_triangular(arm: Peer, reach: Problem) -> None:
    """Each stage of the integrator gives its accelerations of those before: what substitution needs."""
    program = transcribe(choose(reach, "shooting by rk4"), arm).program
    assert program.stages is not None
    assert program.stages.is_triangular
    J = read_pattern(program, arm)[0].toarray()
    for inner, equations in zip(program.stages.inner, program.stages.equations, strict=True):
        block = J[equations.ravel()][:, inner.ravel()].reshape(*equations.shape, *inner.shape)
        for i in range(len(inner)):
            assert np.array_equal(block[i, :, i], np.eye(inner.shape[1]))
            assert not block[i, :, i + 1 :].any()


# --- no graph ------------------------------------------------------------------------------------------------------

TRANSCRIPTION = ("layout", "quantities", "transcription", "writing.program")
EVALUATION = ("elimination", "backends.assembly", "backends.evaluations", "backends.numpy")
WITHOUT = (
    *("ground.functions", "ground.formulas", "ground.program", "problem.structure"),
    *(f"transcription.{name}" for name in TRANSCRIPTION),
    *(f"evaluation.{name}" for name in EVALUATION),
)


@pytest.mark.parametrize("module", WITHOUT)
def test_data_and_numpy_import_no_casadi(module: str) -> None:
    """None of these modules imports it, nor a module of `ocp` that does."""
    folder, seen, open_modules = Path(mbsrun.__file__).parent, set(), [f"mbsrun.ocp.{module}"]
    while open_modules:
        name = open_modules.pop()
        file = folder.joinpath(*name.split(".")[1:]).with_suffix(".py")
        if name in seen or not file.exists():
            continue
        seen.add(name)
        for statement in ast.parse(file.read_text("utf-8")).body:
            if isinstance(statement, ast.Import):
                assert not any(alias.name == "casadi" for alias in statement.names), name
            elif isinstance(statement, ast.ImportFrom) and statement.module is not None:
                open_modules += [statement.module, *(f"{statement.module}.{alias.name}" for alias in statement.names)]
    assert f"mbsrun.ocp.{module}" in seen
