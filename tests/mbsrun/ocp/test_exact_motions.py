"""Motions that polynomials follow exactly meet every row of their programs, however the program is written."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsrun.ocp.evaluation.backends import condensation
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.integrators import SECOND_ORDER
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.guessing.guess import balance
from mbsrun.ocp.problem.problem import (
    Bounds,
    Contact,
    Control,
    End,
    Form,
    Loops,
    Problem,
    Representation,
    State,
    WrenchComponent,
)
from mbsrun.ocp.transcription.transcription import transcribe
from tests.mbsrun.ocp.exact_motions import MESH, PUSHES, T, follow, push_rails, push_sled, rails, sled
from tests.mbsrun.ocp.plants import FREE_RANGE, push
from tests.mbsrun.peer import double_integrator

Array = NDArray[np.float64]


def measure(problem: Problem, plant: Plant, motion: Trajectory) -> Trajectory:
    """Check that a motion meets the rows of its program; return what the program reads off its variables."""
    transcription = transcribe(problem, plant)
    functions = condensation.build(transcription.program, plant)
    x = transcription.pack(motion)
    g = np.asarray(functions.constraint(x, transcription.parameters(problem)).full().ravel())
    lower, upper = transcription.constraint_bounds(problem)
    assert np.maximum(lower - g, g - upper).max() < 1e-12
    assert (lower == upper).sum() > 6
    return transcription.unpack(functions.complete(x) if isinstance(functions, condensation.Condensed) else x)


GRIDS = [(False, MESH), (True, MESH), (False, None)]
FORMS: dict[str, dict[str, Any]] = {
    "standard": {},
    "standard of an ODE": {"representation": Representation.EXP1_O},
    "algebraic": {"representation": Representation.EXP2_A, "family": Family.LEGENDRE},
    "Lobatto": {"family": Family.LOBATTO, "degree": 3},
    "second order": {"integrator": SECOND_ORDER},
    "second order, Legendre": {"integrator": SECOND_ORDER, "family": Family.LEGENDRE, "degree": 3},
    "integral": {"form": Form.INTEGRAL},
    "integral, Legendre": {"form": Form.INTEGRAL, "family": Family.LEGENDRE},
    "integral of an ODE": {"form": Form.INTEGRAL, "representation": Representation.EXP1_O},
    "shooting": {"form": Form.SHOOTING, "mesh": None},
    "shooting by steps": {
        "form": Form.SHOOTING,
        "representation": Representation.EXP1_O,
        "integrator": "rk4",
        "steps": 2,
    },
}


@pytest.mark.parametrize(("is_free", "mesh"), GRIDS)
@pytest.mark.parametrize("name", FORMS)
def test_a_mass_that_is_pushed_meets_every_form(name: str, is_free: bool, mesh: tuple[float, ...] | None) -> None:
    """A constant push in each interval: parabolas, in intervals of different lengths; start and end are known."""
    changes = {"mesh": mesh, **FORMS[name]}
    problem = replace(
        push(3), horizon=T, horizon_range=(1.0, 2.0) if is_free else None, start_q=(0.3,), start_qd=(0.5,), **changes
    )
    scheme = schemes.build(problem.family, problem.degree)
    t, point_t = problem.grid.times(T, scheme.points)
    (q, qd, _), points = follow(t, t), follow(point_t, t)
    if problem.family is Family.LOBATTO:  # its first points belong to their own interval
        points[2][:, 0, 0] = PUSHES
    end = End(coordinates=((0, float(q[-1, 0])),), velocities=((0, float(qd[-1, 0])),))
    motion = Trajectory(t, q, qd, PUSHES[:, None], point_t, *points)
    found = measure(replace(problem, end=end), double_integrator(), motion)
    for part in ("t", "q", "qd", "u", "point_t", "point_q", "point_qd", "point_qdd"):
        assert getattr(found, part) == pytest.approx(getattr(motion, part), abs=1e-11), part


@pytest.mark.parametrize("name", ["standard", "Lobatto", "second order"])
def test_inputs_and_controls_have_a_value_at_each_point(name: str) -> None:
    """Where they are polynomials: a push of t, and a control of 2 - t - q that gives a state its rate with q."""
    states = (State("s", "c + q_slide", start=(0.0, 0.0)),)
    problem = replace(
        push(3, degree=3), horizon=T, mesh=MESH, inputs="polynomial", end=End(), controls=(Control("c"),),
        states=states, **FORMS[name],
    )  # fmt: skip
    scheme = schemes.build(problem.family, 3)
    t, point_t = problem.grid.times(T, scheme.points)

    def move(t_: Array) -> tuple[Array, ...]:
        parts = (t_**3 / 6, t_**2 / 2, t_, 2 * t_ - t_**2 / 2, 2 - t_ - t_**3 / 6)
        return tuple(part[..., None] for part in parts)

    (q, qd, qdd, s, _), points = move(t), move(point_t)
    means = [np.einsum("j,kjm->km", scheme.weights, part) for part in (points[2], points[4])]
    slopes = np.concatenate((qd, qdd, 2 - t[:, None]), axis=1)[:-1]
    motion = Trajectory(
        t, q, qd, means[0], point_t, points[0], points[1], points[2], s, points[3], means[1], points[4], points[2],
        slopes=slopes,
    )  # fmt: skip
    found = measure(problem, double_integrator(), motion)
    for part in ("q", "qd", "u", "point_q", "point_qd", "point_qdd", "point_u", "point_controls", "controls", "states"):
        assert getattr(found, part) == pytest.approx(getattr(motion, part), abs=1e-11), part


LOOPS: dict[str, dict[str, Any]] = {
    "standard": {},
    "standard of an ODE": {"representation": Representation.EXP1_O},
    "algebraic": {"representation": Representation.EXP1_A},
    "standard, Legendre": {"family": Family.LEGENDRE},
    "second order": {"integrator": SECOND_ORDER},
    "integral": {"form": Form.INTEGRAL},
    "integral, Legendre": {"form": Form.INTEGRAL, "family": Family.LEGENDRE},
    "integral of an ODE": {"form": Form.INTEGRAL, "representation": Representation.EXP1_O},
    "shooting": {"form": Form.SHOOTING, "mesh": None},
}


@pytest.mark.parametrize(("is_free", "mesh"), GRIDS)
@pytest.mark.parametrize(
    ("name", "loops"),
    [*((name, Loops.REDUCED) for name in LOOPS), *((name, Loops.MULTIPLIERS) for name in list(LOOPS)[:3])],
)
def test_a_loop_meets_every_form(name: str, loops: Loops, is_free: bool, mesh: tuple[float, ...] | None) -> None:
    """The same motion along x, by five times the force; coordinates that the loop gives are exact too."""
    problem = replace(
        push(3),
        horizon=T,
        horizon_range=(1.0, 2.0) if is_free else None,
        start_q=(0.3, 0.6),
        start_qd=(0.5, 1.0),
        bounds=Bounds((FREE_RANGE,) * 2, (FREE_RANGE,) * 2, (FREE_RANGE,)),
        end=End(),
        loops=loops,
        **{"mesh": mesh, **LOOPS[name]},
    )
    motion = push_rails(problem)
    found = measure(problem, rails(), motion)
    for part in ("q", "qd", "u", "point_q", "point_qd", "point_qdd"):
        assert getattr(found, part) == pytest.approx(getattr(motion, part), abs=1e-11), part


def test_contacts_share_forces_with_inputs_in_a_guess() -> None:
    """By least squares: 2 m/s^2 of y by 1 N each; unknown components have their guess, and others none."""
    problem = replace(
        push(3),
        start_q=(0.0,) * 3,
        start_qd=(0.0,) * 3,
        bounds=Bounds((FREE_RANGE,) * 3, (FREE_RANGE,) * 3, (FREE_RANGE,) * 2),
        wrenches=(WrenchComponent("hand", 0, guess=0.25), WrenchComponent("hand", 1)),
        contacts=(Contact("hand", "hand", axes=(1,), normal=None),),
    )
    t, point_t = problem.grid.times(1.0, schemes.build(Family.RADAU, 2).points)
    point, rates = np.zeros((3, 2, 3)), np.tile([1.0, 0.0, 0.0], (3, 2, 1))
    slopes = np.stack((point_t, 2 + 0 * point_t, 5 + 0 * point_t), axis=-1)
    motion = Trajectory(t, np.zeros((4, 3)), np.zeros((4, 3)), np.zeros((3, 2)), point_t, point, rates, slopes)
    found = balance(motion, problem, sled(), "dynamic")
    assert found.u[:, 0] == pytest.approx(point_t.mean(axis=1) + 0.3 - 0.25)
    assert found.u[:, 1] == pytest.approx([1.0] * 3)
    assert found.point_w == pytest.approx(np.tile([0.25, 1.0, 0.0], (3, 2, 1)))
    still = balance(motion, problem, sled(), "static")
    assert still.u == pytest.approx(np.tile([-0.25, 0.0], (3, 1)))


@pytest.mark.parametrize("is_free", [False, True])
@pytest.mark.parametrize("integrator", ["collocation", SECOND_ORDER])
@pytest.mark.parametrize("family", [Family.RADAU, Family.LEGENDRE])
def test_given_forces_contacts_and_driven_joints_meet_their_rows(
    family: Family, integrator: Literal["collocation", "second-order"], is_free: bool
) -> None:
    problem, motion = push_sled(family, integrator, is_free)
    found = measure(problem, sled(), motion)
    for part in (
        "q",
        "qd",
        "u",
        "point_q",
        "point_qdd",
        "states",
        "point_states",
        "point_u",
        "point_w",
        "controls",
        "unknowns",
    ):
        assert getattr(found, part) == pytest.approx(getattr(motion, part), abs=1e-11), part
