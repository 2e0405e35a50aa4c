"""Summaries of solutions by hand: which lines there are, their numbers, and shortcomings in words."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mbsrun.ocp.problem.problem import Loops
from mbsrun.ocp.showing import phase_summary, summary
from mbsrun.ocp.showing.phase_summary import list_phased_shortcomings, summarise_phases
from mbsrun.ocp.showing.summary import (
    describe_run,
    list_program,
    list_shortcomings,
    number_names,
    summarise,
    write_line,
)
from mbsrun.ocp.solution.solution import CostTerms, Resimulation, Run, Size, Violation

RUN = Run("good", 7, 1.25, 0.0, 2.5, 0.75, "mbs")
CHECK = Resimulation(1e-7, 0, 2e-6, True)


class Margin:
    """By how much a part is violated between points."""

    def __init__(self, name: str, violation: float, tolerated: float = 1e-3) -> None:
        self.name, self.violation, self.tolerated = name, violation, tolerated
        self.is_kept = violation <= tolerated

    def describe(self) -> str:
        return f"{self.name} is off by {self.violation:g}"


def margins(*each: Margin) -> Any:
    violated = [x for x in each if not x.is_kept]
    worst = max(each, key=lambda x: x.violation / x.tolerated) if each else None
    return SimpleNamespace(each=each, worst=worst, violated=violated)


@dataclass(frozen=True)
class Found:
    """A solution, in the parts that a summary reads."""

    run: Run = RUN
    size: Size = field(default_factory=lambda: Size(10, 20, 30, 40))
    cost: CostTerms = field(default_factory=lambda: CostTerms((("inputs", 2.0), ("rates", 0.0), ("speed", 0.5))))
    resimulation: Any = None
    violation: Violation = field(default_factory=lambda: Violation(1e-9, 2e-10))
    model: str = "cart"
    problem: Any = None
    trajectory: Any = None
    starts: Any = None
    refinement: Any = None
    sensitivities: Any = ()
    driving: Any = None
    driven: Any = ()
    is_only_acceptable: bool = False


def make(**given: Any) -> Any:
    problem = {"name": "push", "mesh": None, "unknowns": (), "controls": (), "loops": None, "asked_accuracy": 1e-6}
    problem |= {"intervals": 2} | given.pop("problem", {})
    motion = {"t": np.array([0.0, 0.5, 2.0]), "unknowns": np.zeros(0)} | given.pop("trajectory", {})
    motion.setdefault("spread_inputs", lambda: (None, np.zeros((2, 1, 0))))
    return Found(problem=SimpleNamespace(**problem), trajectory=SimpleNamespace(**motion), **given)


def test_a_plain_solution_has_its_run_its_program_and_its_cost() -> None:
    """Terms of 0 are left out."""
    assert summarise(make()) == {
        "problem": "push, model cart",
        "status": "good, 7 iterations of mbs",
        "time": "1.25 s",
        "  processor": "2.50 s: 0.75 s for functions and derivatives, 1.75 s for linear algebra and the rest",
        "horizon": "2 s",
        "program": "10 variables, 20 constraints",
        "nonzeros": "30 in the Jacobian, 40 in the Hessian's triangle",
        "cost": "2.5",
        "  inputs ": "2",
        "  speed ": "0.5",
        "violation": "1.0e-09 of constraints, 2.0e-10 of bounds",
    }
    assert describe_run(replace(RUN, method="")) == "good, 7 iterations"


def test_a_run_shows_what_it_was_in_place_of_and_how_near_to_optimal() -> None:
    run = replace(RUN, instead="ipopt was asked", decrease=1e-8)
    found = dict(list_program(run, Size(1, 2, 3, 4), ("duration", "2 s")))
    assert found["  instead"] == "ipopt was asked"
    assert found["optimality"] == "small changes lower the cost by 1.0e-08 at most, to first order"
    assert found["duration"] == "2 s"
    convex = dict(list_program(replace(run, gap=1e-8), Size(1, 2, 3, 4), ("duration", "2 s")))["optimality"]
    assert convex.endswith("to first order; the program is convex, so this is its gap of duality")


def test_lines_of_one_name_are_numbered() -> None:
    assert number_names([("a", "1"), ("b ", "2"), ("a", "3"), ("b ", "4"), ("a", "5")]) == {
        "a": "1", "b ": "2", "a (2)": "3", "b (2) ": "4", "a (3)": "5",
    }  # fmt: skip
    assert write_line("cost", "1", 8) == "cost    1"
    assert write_line("a long name ", "1", 8) == "a long name 1"


def test_parts_that_a_problem_has_have_lines() -> None:
    unknowns = (SimpleNamespace(name="mass", softens=""), SimpleNamespace(name="cost", softens=""))
    found = summarise(
        make(
            problem={"unknowns": unknowns, "mesh": (0.25, 0.75)},
            trajectory={"unknowns": np.array([3.0, 4.0])},
            violation=Violation(1e-9, 2e-10, 3e-8, complementarity=4e-7),
            sensitivities=(("mass", 1.5),),
            driven=("hand",),
            driving=np.array([[[1.0], [-2.0]], [[3.0], [0.0]]]),
        )
    )
    assert found["mass"] == "3"
    assert found["unknown cost"] == "4"
    assert found["violation"].endswith(", 3.0e-08 of quaternions' lengths")
    assert found["d cost / d mass "] == "1.5"
    assert found["tau[hand]"] == "-2 to 3"
    assert found["intervals"] == "2, from 0.5 s to 1.5 s"
    assert found["complementarity"] == "4.0e-07 at most, of force times distance [N m], and friction off the slip [W]"


def test_slacks_are_named_with_the_interval_in_which_they_are_the_largest() -> None:
    controls = (SimpleNamespace(softens=""), SimpleNamespace(softens="speed"), SimpleNamespace(softens="force"))
    points = np.zeros((2, 3, 3))
    points[1, 2, 1], points[0, 0, 1] = 0.25, 0.125
    unknown = SimpleNamespace(name="s", softens="place")
    for value, text in ((0.5, "0.5"), (0.0, "not used")):
        found = summarise(
            make(
                problem={"controls": controls, "unknowns": (unknown,)},
                trajectory={"spread_inputs": lambda: (None, points), "unknowns": np.array([value])},
            )
        )
        assert found["slack of speed "] == "0.25, the most from 0.5 to 2 s"
        assert found["slack of force "] == "not used"
        assert found["slack of place "] == text
        assert "s" not in found


def test_loops_show_how_well_they_are_closed() -> None:
    violation = Violation(1e-9, 2e-10, closure=3e-9, closure_rate=4e-8)
    for loops, check, along in (
        (Loops.REDUCED, None, ""),
        (Loops.MULTIPLIERS, replace(CHECK, closure=5e-7), "; 5.0e-07 along the re-simulated motion"),
        (Loops.REDUCED, CHECK, "; unknown (the integrator gave up) along the re-simulated motion"),
    ):
        found = summarise(make(problem={"loops": loops}, violation=violation, resimulation=check))
        assert found["loops"] == summary.LOOPS[loops]
        assert found["closure"] == f"3.0e-09 at all points, 4.0e-08 per s{along}"


def test_refinements_show_their_rounds() -> None:
    first = SimpleNamespace(
        status="bad", cost=None, iterations=3, defect=None, times=(0.0, 1.0), degree=3, variables=9, change=""
    )
    second = SimpleNamespace(
        status="good",
        cost=2.0,
        iterations=4,
        defect=1e-7,
        times=(0.0, 1.0, 2.0),
        degree=4,
        variables=19,
        change="finer",
    )
    for rounds, told in (((first,), "0 rounds"), ((first, second), "1 round"), ((first, second, second), "2 rounds")):
        found = summarise(make(refinement=SimpleNamespace(rounds=rounds, finding="it is enough")))
        assert found["refinement"] == f"{told}; it is enough"
        assert found["  round 0"] == "1 intervals, degree 3, 9 variables: bad, defect unknown"
    assert found["  round 2"] == "2 intervals, degree 4, 19 variables: cost 2, 4 iterations, defect 1.0e-07; finer"


# --- checks ---------------------------------------------------------------------------------------------------------


def test_checks_show_defects_ends_and_margins() -> None:
    found = summarise(make(resimulation=replace(CHECK, margins=margins(Margin("q", 1e-4)))))
    assert found["defect"] == "1.0e-07 in an interval, at most; 1.0e-06 asked for"
    assert found["open loop"] == "2.0e-06 off at the end, under the inputs alone"
    assert found["between"] == "the grid's points, bounds and constraints are violated by 1.0e-04 at most"
    assert "slip" not in found
    slipped = summarise(make(resimulation=replace(CHECK, slip=1e-9, slip_along=2e-8, margins=margins())))
    assert slipped["slip"] == "1.0e-09 m of a contact at all points; 2.0e-08 along the re-simulated motion"
    assert "between" not in slipped
    inside = summarise(make(resimulation=replace(CHECK, margins=margins(Margin("q", -0.5)))))
    assert inside["between"].endswith("violated by 0.0e+00 at most")


def test_margins_that_are_violated_are_named() -> None:
    one, two, three = Margin("q", 0.5), Margin("u", 0.25), Margin("v", 1e-6)
    found = summarise(make(resimulation=replace(CHECK, margins=margins(one, three))))
    assert found["between"] == "the grid's points, q is off by 0.5; tolerated 1.0e-03"
    found = summarise(make(resimulation=replace(CHECK, margins=margins(one, two, three))))
    assert found["between"].endswith("; tolerated 1.0e-03; 1 more")


@pytest.mark.parametrize(
    ("lost", "text"),
    [
        ((), ""),
        ((0.5,), "; unstable: it left the solution, and was put back on it, once at 0.5 s"),
        ((0.5, 1.5), "; unstable: it left the solution, and was put back on it, 2 times, first at 0.5 s"),
    ],
)
def test_motions_that_leave_the_solution_say_where(lost: tuple[float, ...], text: str) -> None:
    found = summarise(make(resimulation=replace(CHECK, lost=lost, margins=margins())))
    assert found["open loop"] == f"2.0e-06 off at the end, under the inputs alone{text}"


def test_checks_that_did_not_end_say_why() -> None:
    for unfinished, why in (("", "the integrator gave up"), ("60 s", "the re-simulation did not finish")):
        check = Resimulation(None, None, None, False, unfinished=unfinished)
        found = summarise(make(resimulation=check))
        assert found["defect"].startswith(f"unknown ({why}) in an interval")
        assert found["between"] == f"unknown ({why})"


def list_of(check: Any, **given: Any) -> list[str]:
    return list_shortcomings(make(resimulation=check, **given))


def test_a_solution_without_shortcomings_has_none() -> None:
    for check in (
        None,
        CHECK,
        replace(CHECK, closure=summary.CLOSED),
        replace(CHECK, margins=margins(Margin("q", 0.0))),
    ):
        assert list_of(check) == []


def test_one_shortcoming_of_the_check_is_listed_the_gravest() -> None:
    """Unfinished before open before inaccurate."""
    wrong = replace(CHECK, is_accurate=False)
    (found,) = list_of(wrong)
    assert found.startswith("the largest defect of an interval, 1.0e-07, is above the accuracy asked for, 1.0e-06;")
    opened = replace(wrong, closure=1.01 * summary.CLOSED)
    (found,) = list_of(opened)
    assert found.startswith("along the re-simulated motion the loops open by ")
    (found,) = list_of(replace(opened, unfinished="60 s are over"))
    assert found.startswith("the re-simulation did not finish, 60 s are over, so the accuracy is unknown;")
    assert len(list_of(CHECK, is_only_acceptable=True)) == 1
    assert list_of(None, is_only_acceptable=True)[0].startswith("the solver stopped at an acceptable level")


def test_violations_between_points_are_listed_up_to_three() -> None:
    each = [Margin(name, 0.5) for name in "abcde"]
    for count, more in ((1, ""), (3, ""), (5, "; and 2 more")):
        (found,) = list_of(replace(CHECK, margins=margins(*each[:count])))
        shown = "; ".join(x.describe() for x in each[: min(count, 3)])
        assert (
            found
            == f"between the points of the grid, {shown}{more}; take more intervals there, or let refine split them"
        )


# --- phases ---------------------------------------------------------------------------------------------------------


class Followed:
    """A simulation from event to event."""

    def __init__(self, finding: str) -> None:
        self.finding = finding

    def describe(self) -> str:
        return f"differs: {self.finding}" if self.finding else "agrees"


def make_phases(*parts: Any, single: bool = False, **given: Any) -> Any:
    known: dict[str, Any] = {
        "name": "walk", "problem": SimpleNamespace(is_single=single), "single": parts[0], "phases": parts,
        "names": tuple("ab"[: len(parts)]), "run": RUN, "size": Size(1, 2, 3, 4), "durations": (0.5, 1.5), "cost": 3.5,
        "search": None, "unknowns": (), "unknown_values": (), "sensitivities": (), "values": (), "followed": (),
        "is_only_acceptable": False,
    }  # fmt: skip
    return SimpleNamespace(**(known | given))


def test_phases_have_the_lines_that_are_their_own() -> None:
    """The program and its run are of the whole."""
    impulse = SimpleNamespace(sensor="foot", components=(1.0, 0.0, 2.5))
    link = SimpleNamespace(
        source="a", target="b", violation=1e-9, terms=(("effort", 2.0), ("none", 0.0)), impulses=(impulse,),
        stops=(("knee", 0.5),),
    )  # fmt: skip
    part = make(resimulation=replace(CHECK, margins=margins(Margin("q", 0.0))))
    found = summarise_phases(
        make_phases(
            part, part, values=(link,), unknowns=(SimpleNamespace(name="mass"),), unknown_values=(3.0,),
            sensitivities=(("mass", 1.5),), followed=(Followed("late"),),
        )
    )  # fmt: skip
    assert found["problem"] == "walk, 2 phases"
    assert (found["duration"], found["cost"], found["mass"]) == ("2 s", "3.5", "3")
    assert found["d cost / d mass "] == "1.5"
    assert found["phase b"] == "model cart"
    own = [name.removeprefix("b: ") for name in found if name.startswith("b: ")]
    assert own == ["horizon", "cost", "violation", "defect", "open loop", "between"]
    assert found["link a to b"] == "violation 1.0e-09"
    assert found["  effort "] == "2"
    assert "  none " not in found
    assert found["  impulse of foot "] == "1, 0, 2.5 N s"
    assert found["  impulse of the stop of knee "] == "0.5"
    assert found["sequence"] == "differs: late"
    assert summarise_phases(make_phases(part))["problem"] == "walk, 1 phase"


def test_a_single_phase_has_the_summary_of_its_solution() -> None:
    found = summarise_phases(make_phases(make(), single=True, followed=(Followed(""),)))
    assert found["problem"] == "push, model cart"
    assert found["sequence"] == "agrees"


def test_shortcomings_of_phases_are_named_by_them(monkeypatch: pytest.MonkeyPatch) -> None:
    wrong, right = make(resimulation=replace(CHECK, is_accurate=False)), make(resimulation=CHECK)
    found = list_phased_shortcomings(make_phases(right, wrong, followed=(Followed(""), Followed("late"))))
    assert found[0] == "the simulation from event to event differs: late"
    assert found[1].startswith("phase b: the largest defect")
    assert len(found) == 2
    only = list_phased_shortcomings(make_phases(right, right, is_only_acceptable=True))
    assert only == ["IPOPT stopped at an acceptable level, short of the tolerance; try another guess or scaling"]
    single = list_phased_shortcomings(make_phases(wrong, single=True, followed=(Followed("late"),)))
    assert single[0].startswith("the largest defect")
    assert single[1:] == ["the simulation from event to event differs: late"]
    monkeypatch.setattr(phase_summary, "list_shortcomings", lambda part: [part.run.status])
    assert list_phased_shortcomings(make_phases(right, right))[1] == f"phase b: {phase_summary.SOLVED}"
