"""Problems in words: each part by hand, as a notebook and a terminal show it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from mbsrun.ocp.problem.phases import Condition, Impact, Link
from mbsrun.ocp.problem.problem import (
    Bounds,
    Constraint,
    Contact,
    Control,
    Cost,
    Delay,
    Drive,
    End,
    Force,
    Form,
    Integral,
    Problem,
    State,
    Symbolic,
    Term,
    Unknown,
    WrenchComponent,
)
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.optimal import phases
from mbsrun.optimal.describing import LONGEST, describe_problem
from mbsrun.optimal.phases import PhasedControl, _describe_link
from mbsrun.quantities import SIGNAL
from tests.mbsrun.ocp.plants import FREE_RANGE, cart_pole, push
from tests.mbsrun.peer import double_integrator

SLIDE, CART = double_integrator().manifest, cart_pole().manifest
INF = math.inf


def tell(**changes: Any) -> dict[str, str]:
    return describe_problem(replace(push(4), **changes), SLIDE)


def tell_two(**changes: Any) -> dict[str, str]:
    """Describe a problem of a cart and a pole, of which the cart has an input."""
    free = (FREE_RANGE, FREE_RANGE)
    plain: dict[str, Any] = {
        "start_q": (0.0, 0.0), "start_qd": (0.0, 0.0), "bounds": Bounds(free, free, free[:1]), "end": End()
    }  # fmt: skip
    problem: Problem = replace(push(4), **(plain | changes))
    return describe_problem(problem, CART)


def test_a_plain_problem_shows_what_it_has() -> None:
    assert tell() == {
        "model": "double integrator: coordinates slide; inputs slide; sensors place",
        "horizon": "1 s",
        "grid": "4 intervals, radau points of degree 2, form standard, IMPL",
        "cost": "1 * inputs",
        "start": "all 0",
        "end": "q_slide = 1, velocity 0",
        "solver": "mbs, tolerance 1e-08",
    }
    assert tell_two()["model"] == "cart-pole: coordinates cart, pole; inputs cart; sensors none"
    assert "end" not in tell_two()


def test_horizons_and_grids() -> None:
    assert tell(horizon_range=(0.5, 3.0))["horizon"] == "free, 0.5 <= T <= 3, guess 1 s"
    assert tell(horizon_range=(0.5, INF), horizon=2.0)["horizon"] == "free, 0.5 <= T, guess 2 s"
    shooting = tell(form=Form.SHOOTING, steps=3, integrator="rk4")["grid"]
    assert shooting == "4 intervals, radau points of degree 2, form shooting, rk4, 3 steps, IMPL"


def test_costs_name_their_terms_and_those_at_the_end() -> None:
    cost = Cost(0.0, 2.0, (Term("u_slide**4", 3.0), Term("f", 0.5)), (Term("qd_slide", -1.0),), (("c", 4.0),))
    function = Symbolic("f", (), "cos(q)")
    found = tell(cost=cost, functions=(function,), controls=(Control("c"),))["cost"]
    assert found.startswith("2 * ")
    assert "3 * u_slide**4" in found
    assert "4 * " in found
    assert "-1 * qd_slide (end)" in found
    assert "0.5 * cos(q)" in found
    assert "u_slide**4 (end)" not in found
    assert found.count("(end)") == 1


@pytest.mark.parametrize(
    ("q", "qd", "free", "text"),
    [
        ((0.0, 0.0), (0.0, 0.0), (), "all 0"),
        ((1.5, 0.0), (0.0, -2.0), (), "q_cart = 1.5, qd_pole = -2, the rest 0"),
        ((1.5, 0.0), (0.0, 0.0), (0, 3), "q_cart free, qd_pole free, the rest 0"),
        ((1.0, 2.0), (3.0, 4.0), (), "q_cart = 1, q_pole = 2, qd_cart = 3, qd_pole = 4"),
    ],
)
def test_starts_show_what_is_not_0(q: Any, qd: Any, free: Any, text: str) -> None:
    assert tell_two(start_q=q, start_qd=qd, free_start=free)["start"] == text


def test_ends_show_all_their_conditions() -> None:
    end = End(
        sensors=(("place", (1.0, None, 0.5)),), coordinates=((1, 2.0),), velocity_zero=True, acceleration_zero=True,
        velocities=((0, 3.0),), accelerations=((1, 4.0),), sensor_velocities=(("place", (None, None, 0.0)),),
        orientations=(("place", ((0, (0.0, 0.0, 1.0)),)),),
    )  # fmt: skip
    assert tell_two(end=end)["end"] == (
        "place at (1, free, 0.5), place turned: x along (0, 0, 1), q_pole = 2, velocity 0, acceleration 0, "
        "qd_cart = 3, qdd_pole = 4, place moves at (free, free, 0)"
    )


def test_bounds_show_the_sides_that_there_are() -> None:
    wide = FREE_RANGE
    bounds = Bounds(((-1.0, 2.0), wide), (wide, (-INF, 3.0)), ((4.0, INF),), ((0.0, 0.0),))
    controls = (Control("c", rates=(-5.0, 5.0)), Control("d"))
    assert tell_two(bounds=bounds, controls=controls)["bounds"] == (
        "-1 <= q_cart <= 2, qd_pole <= 3, 4 <= u_cart, rate of u_cart = 0, -5 <= rate of c <= 5"
    )


def test_constraints_show_where_they_hold_unless_they_have_a_name() -> None:
    given = (
        Constraint("q_slide", (0.0, 1.0)),
        Constraint("f", (-INF, 2.0), "end"),
        Constraint("qd_slide", (3.0, 3.0), "start"),
        Constraint("hidden", (0.0, 1.0), name="a friend"),
    )
    found = tell(constraints=given, functions=(Symbolic("f", (), "cos(q)"),))["constraints"]
    assert found == "0 <= q_slide <= 1, cos(q) <= 2 (end), qd_slide = 3 (start)"


def test_additions_are_shown_by_their_kinds() -> None:
    found = tell(
        states=(State("act", "exc - act"),),
        controls=(Control("exc", (0.0, 1.0)),),
        delays=(Delay("input", 0, 0.25, None), Delay("control", 0, 0.5, 2.0)),
        driven=(Drive(0, "sin(t)"),),
        forces=(Force(0, "2*act"),),
        wrenches=(
            WrenchComponent("hand", 1, "act"),
            WrenchComponent("hand", 5, None, (0.0, INF)),
            WrenchComponent("wind", SIGNAL, "3"),
        ),
        contacts=(Contact("sole", "sole"),),
        unknowns=(Unknown("mass", (1.0, 2.0)),),
        integrals=(Integral("u_slide**2", (-INF, 9.0)),),
        parameters=(("k", 0.5),),
        references=(SimpleNamespace(name="walk"),),
        constants=(("g", 9.81), ("n", 2.0)),
    )
    expected = {
        "states": "act' = exc - act",
        "controls": "0 <= exc <= 1",
        "delays": "u_slide by 0.25 s, free before, exc by 0.5 s, 2 before",
        "driven": "slide = sin(t)",
        "forces": "u_slide = 2*act",
        "wrenches": "fy_hand = act, 0 <= mz_hand, signal_wind = 3",
        "contacts": "sole",
        "unknowns": "1 <= mass <= 2",
        "integrals": "u_slide**2 <= 9",
        "parameters": "k = 0.5",
        "references": "walk",
        "constants": "g = 9.81, n = 2",
    }
    assert {name: found[name] for name in expected} == expected


def test_of_many_parts_the_first_are_shown() -> None:
    for count, more in ((LONGEST, ""), (LONGEST + 1, ", and 1 more"), (LONGEST + 3, ", and 3 more")):
        constants = tuple((f"c{k}", float(k)) for k in range(count))
        shown = ", ".join(f"c{k} = {k}" for k in range(LONGEST))
        assert tell(constants=constants)["constants"] == shown + more


# --- phases ---------------------------------------------------------------------------------------------------------


def test_links_are_described_by_their_parts() -> None:
    assert _describe_link(Link("a", "b")) == "the state goes on"
    impact = Impact((Contact("toe", "toe"), Contact("heel", "heel")), 0.5)
    link = Link(
        "a",
        "b",
        (("x", "y + 1"), ("z", None)),
        (("v", "2"),),
        impact,
        (Condition("c1", (0.0, 1.0)),),
        (Term("t", 3.0),),
    )
    assert _describe_link(link) == "x = y + 1; v = 2; impact of toe, heel, restitution 0.5; c1; cost 3 * t"


def make_control(**given: Any) -> PhasedControl:
    """Make a problem of phases a and b of one model, in words alone."""
    problem = push(4)
    parts = [SimpleNamespace(name=name, problem=problem) for name in ("a", "b")]
    value: Any = SimpleNamespace(name="two", phases=parts, links=(Link("a", "b"),), solver=problem.solver, **given)
    plants: Any = SimpleNamespace(phases=[SimpleNamespace(manifest=SLIDE)] * 2)
    return PhasedControl(value, plants, {}, Path(), {})


def test_phases_are_described_one_by_one_with_one_solver() -> None:
    found = make_control().describe()
    assert found["a: horizon"] == found["b: horizon"] == "1 s"
    assert found["a to b"] == "the state goes on"
    assert [name for name in found if "solver" in name] == ["solver"]
    assert found["solver"] == "mbs, tolerance 1e-08"


def test_guesses_of_phases_are_taken_by_their_kinds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Files and folders, guesses by the names of phases, and guesses as they are; nothing else."""
    own = make_control()
    asked: list[Any] = []
    monkeypatch.setattr(phases, "find_phased_guess", lambda *given: asked.append(given[2:]))
    monkeypatch.setattr(phases, "equip_phases", lambda _, plants: plants)
    monkeypatch.setattr(phases, "read_motion", lambda guess, *_: f"read {guess}")
    own._find_guess(None)
    own._find_guess("walk.csv")
    own._find_guess(Path("walk.csv"))
    assert asked == [(Path(), None), (Path(), Path("walk.csv")), (Path(), Path("walk.csv"))]
    found: Any = own._find_guess({"b": "g"})  # type: ignore[dict-item]
    assert found.trajectories == (("b", "read g"),)
    with pytest.raises(ProblemError, match="found a value of type int; give a solution of these phases, a file"):
        own._find_guess(3)  # type: ignore[arg-type]
