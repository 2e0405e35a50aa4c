"""Programs that several tests transcribe: a problem that asks for everything, its derivatives, the sizes of table 3."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from mbsrun.ocp.evaluation.backends import condensation
from mbsrun.ocp.evaluation.backends.casadi import CasadiProgram, Functions
from mbsrun.ocp.evaluation.backends.condensation import Condensed
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.problem.problem import Constraint, Cost, End, Problem, Representation, Term
from mbsrun.ocp.transcription.transcription import Transcription, transcribe
from tests.mbsrun.peer import Peer


def small(reach: Problem, family: Family, degree: int) -> Problem:
    return replace(reach, intervals=3, family=family, degree=degree)


TABLE_3 = {  # variables, constraints, nonzeros of the Jacobian, nonzeros of the Hessian's upper triangle
    Representation.IMPL: (8812, 8427, 72435, 39206),
    Representation.SEMI: (8812, 8427, 72435, 39206),
    Representation.EXP1_O: (6412, 6027, 62519, 35286),
    Representation.EXP1_A: (8812, 8427, 69635, 35206),
    Representation.EXP2_O: (6412, 6027, 62519, 35286),
    Representation.EXP2_A: (8812, 8427, 69635, 35206),
}


def rich(reach: Problem, representation: Representation, family: Family, free: bool) -> Problem:
    """Ask for everything that a problem can ask for."""
    return replace(
        small(reach, family, 2),
        representation=representation,
        horizon_range=(1.0, 3.0) if free else None,
        free_start=(1, 8),
        cost=Cost(
            3.0,
            0.5,
            (Term("(q_q2 - a)**2 + u_q1*qd_q1", 2.0), Term("t*sin(q_q3) + T*y_hand", 0.25), *[Term("1", 0.125)] * 2),
            (Term("T**2 + z_hand*q_q5", 4.0), Term("qdd_q2**2", 0.1)),
        ),
        end=End(
            sensors=(("hand", (0.1, 0.2, 0.3)),),
            coordinates=((4, 0.25),),
            velocities=((1, 0.5), (2, -0.5)),
            accelerations=((0, 1.5), (5, -1.0)),
            sensor_velocities=(("pendulum", (0.1, 0.0, -0.1)),),
        ),
        constraints=(
            Constraint("x_hand**2 + b*t", (-1.0, 2.0)),
            Constraint("qdd_q1 - u_q1", (-np.inf, 3.0)),
            Constraint("qdd_q3 + q_q1", (0.0, 0.0), "start"),
            Constraint("vx_hand - a*T", (0.0, np.inf), "end"),
        ),
        constants=(("a", 0.3), ("b", -0.7)),
    )


def functions_of(problem: Problem, plant: Plant) -> Functions:
    """Transcribe a problem, and make the functions of its program."""
    return condensation.build(transcribe(problem, plant).program, plant)


def evaluate_rows(transcription: Transcription, plant: Plant, problem: Problem, x: np.ndarray) -> np.ndarray:
    """Return g at x."""
    functions = condensation.build(transcription.program, plant)
    return np.asarray(functions.constraint(x, transcription.parameters(problem)).full().ravel())


def evaluate_terms(transcription: Transcription, plant: Plant, problem: Problem, x: np.ndarray) -> list[float]:
    """Return the terms of the cost at x, weights included."""
    functions = condensation.build(transcription.program, plant)
    terms = functions.terms(x, transcription.parameters(problem)).full().ravel() * problem.cost.weights
    return [float(term) for term in terms]


def check_derivatives(
    problem: Problem,
    arm: Peer,
    expand: Callable[[Any, ca.MX], tuple[Any, ca.MX]] = lambda program, x: (program, x),
    more: int = 0,
    near: np.ndarray | None = None,
) -> None:
    """Compare with CasADi's of the same program; `expand` gives a form of it that CasADi can differentiate.

    There may be as many more nonzeros than CasADi finds. Variables are random, or `near` some place.
    """
    transcription = transcribe(problem, arm)
    program = condensation.build(transcription.program, arm)
    x, p = ca.MX.sym("x", program.variables), ca.MX.sym("p", program.parameters)
    plain, v = expand(program, x)
    nlp = {"x": x, "p": p, "f": plain.objective(v, p), "g": plain.constraint(v, p)}
    whole = ca.nlpsol("whole", "ipopt", nlp, {"ipopt.print_level": 0})
    rng = np.random.default_rng(1)
    x0 = rng.uniform(0.5, 1, program.variables)
    at = x0 if near is None else near + (x0 - 0.75) / 5, transcription.parameters(problem)
    multipliers = (0.7, rng.uniform(-1, 1, program.constraints))
    for name, ours, arguments in (
        ("nlp_grad_f", program.gradient, at),
        ("nlp_jac_g", program.jacobian, at),
        ("nlp_hess_l", program.hessian, (*at, *multipliers)),
    ):
        expected, found = (f.call([ca.DM(a) for a in arguments])[-1] for f in (whole.get_function(name), ours))
        scale = np.abs(expected.full()).max()
        assert np.abs((found - expected).full()).max() <= 1e-10 * scale, name
        assert found.nnz() <= expected.nnz() + more, name


def equations_of(condensed: Condensed) -> CasadiProgram:
    """Return the rows that are solved."""
    program = condensed.program
    assert program.stages is not None
    return CasadiProgram(program.restrict(program.stages.equations.ravel()), condensed.rest.plant)


def unroll(condensed: Condensed, x: ca.MX) -> tuple[CasadiProgram, ca.MX]:
    """Return the remaining rows, and all variables, by as many iterations as necessary, for CasADi to differentiate."""
    unknowns, equations = condensed.inner.unknowns, equations_of(condensed)
    z = ca.MX.zeros(unknowns.size)
    order = np.argsort(np.concatenate((condensed.program.kept, unknowns))).tolist()
    nothing = ca.DM.zeros(condensed.parameters)
    if condensed.inner.parts[0].orders:  # stage after stage is exact
        for _ in condensed.inner.parts[0].orders:
            z -= equations.constraint(ca.vertcat(x, z)[order], nothing)
    else:
        for _ in range(8):
            v = ca.vertcat(x, z)[order]
            r, J = equations.constraint(v, nothing), equations.jacobian(v, nothing)
            z -= ca.solve(J[:, unknowns.tolist()], r, "qr")
    return condensed.rest, ca.vertcat(x, z)[order]
