"""Trial files: what each number becomes, and its last value that is taken."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mbsgen.errors import InputError
from mbsgen.expressions import FLOATS, evaluate
from mbsgen.manifest import Loop, Wrench
from mbsrun.ocp.problem.problem import Bounds, Constraint, Control, Problem, State
from mbsrun.simulation.integration.methods import METHODS
from mbsrun.tracking.statement import TrialStatement
from mbsrun.tracking.trial import Fallback, Horizon, Kick, Trial
from tests.mbsrun.ocp.plants import FREE_RANGE, push
from tests.mbsrun.peer import double_integrator

PARTS = (("a", True, False), ("b", True, True), ("c", False, True))
WRENCHES = tuple(Wrench(name=name, frame=0, in_base=True, force=f, moment=m) for name, f, m in PARTS)
MANIFEST = double_integrator().manifest.model_copy(update={"wrenches": WRENCHES})
STATES = (State("heat", "1", start=(4.0, 4.0)), State("free", "1", start=(0.0, 1.0)))
PROBLEM = replace(
    push(4), start_q=(0.25,), start_qd=(0.5,), states=STATES, constants=(("k", 2.0), ("t0", 0.0)),
    controls=(Control("c"),), constraints=(Constraint("q_slide**2", (0, 4)), Constraint("q_slide", (0, 4), "end")),
    bounds=Bounds(((0.0, 2.0),), (FREE_RANGE,), (FREE_RANGE,)),
)  # fmt: skip
USUAL: dict[str, Any] = {"duration": 2, "rate": 20, "start": {"states": {"free": 0}}}


def read(problem: Problem = PROBLEM, **changes: Any) -> tuple[Trial, dict[str, float]]:
    return TrialStatement(None, {**USUAL, **changes}).trial(problem, MANIFEST, {"m": 2.0, "l": 3.0})


def find_faults(call: Callable[[], object]) -> list[tuple[str, str]]:
    try:
        call()
    except InputError as error:
        return [(fault.path, fault.finding) for fault in error.faults]
    return []


def refuse(problem: Problem = PROBLEM, **changes: Any) -> list[tuple[str, str]]:
    return find_faults(lambda: read(problem, **changes))


def test_a_trial_has_quiet_defaults() -> None:
    """Nothing disturbs, nothing is late, and the plant starts where the problem does."""
    trial, parameters = read()
    assert (trial.name, trial.duration, trial.period, trial.delay, trial.predicts) == ("push", 2.0, 0.05, 0, True)
    assert (trial.fallback, trial.horizon, trial.noise.seed) == (Fallback.PLAN, None, 0)
    assert (trial.start_q.tolist(), trial.start_qd.tolist(), trial.start_states.tolist()) == ([0.25], [0.5], [4.0, 0.0])
    assert [x.tolist() for x in (trial.noise.q, trial.noise.qd, trial.noise.u)] == [[0.0], [0.0], [0.0, 0.0]]
    assert (trial.integration.method, trial.integration.max_seconds, trial.integration.duration) == ("dop853", 10, 0.05)
    assert (trial.kicks, trial.pushes, trial.measures, trial.leeway, parameters) == ((), (), (), {}, {})
    assert (trial.states, trial.controls) == (("heat", "free"), ("c",))


def test_numbers_are_expressions_of_constants() -> None:
    trial, parameters = read(
        constants={"h": "k/4"}, start={"pose": {"slide": "h"}, "velocity": {"slide": "2*h"}, "states": {"free": "h"}},
        noise={"coordinates": "h", "velocities": {"slide": 3}, "inputs": {"c": 5}, "seed": 7},
        plant={"parameters": {"m": "4*h"}, "scale": {"l": "h"}},
    )  # fmt: skip
    assert trial.constants == {"k": 2.0, "t0": 0.0, "h": 0.5}
    assert (trial.start_q[0], trial.start_qd[0], trial.start_states.tolist()) == (0.5, 1.0, [4.0, 0.5])
    assert [x.tolist() for x in (trial.noise.q, trial.noise.qd, trial.noise.u)] == [[0.5], [3.0], [0.0, 5.0]]
    assert trial.noise.seed == 7
    assert parameters == {"m": 2.0, "l": 1.5}


def test_entries_of_a_push_are_counted_over_all_open_wrenches() -> None:
    """A force has three entries and a moment three more, in the order of the model."""
    pushes = [
        {"wrench": name, "from": 0.5, "until": 1, key: [1, "2*t", 3]}
        for name, key in (("a", "force"), ("b", "force"), ("b", "moment"), ("c", "moment"))
    ]
    trial, _ = read(wrenches=pushes)
    assert [[i for i, _ in push.entries] for push in trial.pushes] == [[0, 1, 2], [3, 4, 5], [6, 7, 8], [9, 10, 11]]
    assert [evaluate(x, {"t": 0.75}, FLOATS) for _, x in trial.pushes[3].entries] == [1, 1.5, 3]
    assert (trial.pushes[0].start, trial.pushes[0].end) == (0.5, 1.0)
    for name, key in (("a", "moment"), ("c", "force")):
        found = refuse(wrenches=[{"wrench": name, "from": 0.5, "until": 1, key: [1, 2, 3]}])
        assert found == [(f"wrenches[0].{key}", f"the {key} of this wrench is not an input")]


def test_times_lie_in_the_loop_and_follow_each_other() -> None:
    """A kick before the end, a push that lasts, a measure that begins before it ends."""
    assert read(kicks=[{"time": 0, "velocity": {"slide": 3}}])[0].kicks == (Kick(0.0, ((0, 3.0),)),)
    read(kicks=[{"time": 1.999, "velocity": {}}])
    assert refuse(kicks=[{"time": 2, "velocity": {}}]) == [("kicks[0].time", "found 2")]
    found = refuse(wrenches=[{"wrench": "a", "from": 1, "until": 1, "force": [1, 2, 3]}])
    assert found == [("wrenches[0].until", "found 1, and from is 1")]
    measure = {"name": "x", "expression": "q_slide + heat"}
    (measured,) = read(measures=[{**measure, "from": 1.99, "most": "k"}])[0].measures
    assert (measured.start, measured.end, measured.most) == (1.99, math.inf, 2.0)
    assert read(measures=[{**measure, "from": 1, "until": 1.5}])[0].measures[0].end == 1.5
    assert refuse(measures=[{**measure, "from": 2}]) == [("measures[0].from", "nothing is measured from 2 s on")]
    found = refuse(measures=[{**measure, "from": 1, "until": 1}])
    assert found == [("measures[0].from", "nothing is measured from 1 s on")]


def test_delays_and_seeds_are_whole_numbers_from_0() -> None:
    assert (read(delay=100)[0].delay, read(noise={"seed": 0})[0].noise.seed) == (100, 0)
    assert [path for path, _ in refuse(delay=101)] == ["delay"]
    assert [path for path, _ in refuse(delay=-1)] == ["delay"]
    assert [path for path, _ in refuse(noise={"seed": -1})] == ["noise.seed"]


def test_a_horizon_is_at_least_a_period() -> None:
    assert read(horizon={"end": 1, "least": 0.05})[0].horizon == Horizon(1.0, 0.05)
    assert refuse(horizon={"end": 1, "least": 0.04}) == [("horizon.least", "found 0.04")]
    assert refuse(horizon={"end": 0, "least": 0.05}) == [("horizon.end", "found 0")]
    free = replace(PROBLEM, horizon_range=(0.5, 2.0))
    assert refuse(free) == [("horizon", "the problem's horizon is free")]
    assert read(free, horizon={"end": 1, "least": 0.5})[0].horizon == Horizon(1.0, 0.5)


def test_a_state_that_begins_anywhere_is_asked_for() -> None:
    finding = "the problem does not say where the state free begins"
    assert refuse(start={}) == [("start.states", finding)]
    assert refuse(start={"states": {"free": 0, "cold": 1}}) == [("start.states.cold", 'the model has no state "cold"')]
    assert read(start={"states": {"free": 1, "heat": 2}})[0].start_states.tolist() == [2.0, 1.0]


def test_a_number_of_the_plant_is_given_or_scaled() -> None:
    found = refuse(plant={"parameters": {"m": 1}, "scale": {"m": 2}})
    assert found == [("plant.scale.m", "this number has a value under parameters")]


def test_controls_move_the_plant_as_one_system() -> None:
    """Its method and tolerances are fixed; the limit of time is not."""
    assert read(plant={"max_seconds": 3})[0].integration.max_seconds == 3
    for key in ("rtol", "atol"):
        finding = "controls and forces of the problem move the plant with its states, by DOP853 at 1e-13"
        assert refuse(plant={key: 1e-6}) == [(f"plant.{key}", finding)]
    alone = replace(PROBLEM, controls=())
    assert read(alone, plant={"rtol": 1e-6})[0].integration.rtol == 1e-6


def test_methods_without_loops_are_refused_for_closed_ones() -> None:
    """Without loops every method is taken that has nothing to say about its step."""
    alone = replace(PROBLEM, controls=())
    loops = MANIFEST.model_copy(update={"loops": (Loop(name="l", cut="ball"),)})
    for name, method in METHODS.items():
        words = [("plant.method", f"{name} takes no loops")]
        for manifest, expected in ((MANIFEST, []), (loops, [] if method.closed else words)):
            statement = TrialStatement(None, {**USUAL, "plant": {"method": name}})
            assert find_faults(lambda of=manifest, by=statement: by.trial(alone, of, {})) == expected


def test_a_fault_of_the_plant_has_its_place() -> None:
    statement = TrialStatement(None, {**USUAL, "plant": {"model": "none.yaml"}})
    fault = statement.fault(("plant", "model"), "there is none", "give another")
    assert (fault.path, fault.finding, fault.remedy) == ("plant.model", "there is none", "give another")


def test_leeway_is_of_bounds_of_states_and_of_constraints_along_the_path() -> None:
    given = {"q_slide": 0.1, "heat": 0, "q_slide**2": "k"}
    assert read(leeway=given)[0].leeway == {"q_slide": 0.1, "heat": 0.0, "q_slide**2": 2.0}
    for name in ("qd_slide", "u_slide", "c"):
        assert refuse(leeway={name: 0.1}) == [(f"leeway.{name}", f'the problem has no bound or constraint of "{name}"')]
    assert refuse(leeway={"heat": -0.1}) == [("leeway.heat", "found -0.1")]


def test_references_are_of_the_state_over_time() -> None:
    trial, _ = read(references={"q_slide": "sin(t)", "x_place": "k*t"})
    assert sorted(trial.references) == ["q_slide", "x_place"]
    for name, expression in (("u_slide", "t"), ("q_slide", "qd_slide")):
        assert [path for path, _ in refuse(references={name: expression})] == [f"references.{name}"]


def test_constants_have_names_of_their_own() -> None:
    for name in ("t", "q_slide", "heat", "c", "k", "sin"):
        assert refuse(constants={name: 1}) == [(f"constants.{name}", "no name for a constant")]


def test_a_plant_has_the_coordinates_and_inputs_of_the_controller() -> None:
    finding = "its coordinates or inputs are not the controller's"
    for changes in ({"start_q": (0.0, 0.0)}, {"start_qd": ()}, {"bounds": Bounds((), (), ())}):
        assert ("plant.model", finding) in refuse(replace(PROBLEM, **changes))
    driven = MANIFEST.model_copy(update={"driven": (0,)})
    with pytest.raises(InputError, match="it drives slide, which nothing moves here"):
        TrialStatement(None, USUAL).trial(PROBLEM, driven, {})


def test_updates_change_constants_of_the_problem_over_time() -> None:
    trial, _ = read(updates={"t0": "2*t"})
    assert trial.constants_at(0.5) == {"t0": 1.0}
    (fault,) = refuse(updates={"t1": "t"})
    assert fault == ("updates.t1", 'no expression of the problem reads a constant "t1"')


def test_methods_and_models_of_a_plant_are_known() -> None:
    for key, value, finding in (("method", "magic", 'found "magic"'), ("model", "plant.xml", 'found "plant.xml"')):
        with pytest.raises(InputError) as error:
            TrialStatement(None, {**USUAL, "plant": {key: value}})
        assert [(fault.path, fault.finding) for fault in error.value.faults] == [(f"plant.{key}", finding)]
    changes = TrialStatement(None, {**USUAL, "plant": {"model": "plant.yml"}}).changes
    assert (changes.model, changes.is_released) == ("plant.yml", False)
    for given in ({"parameters": {"m": 1}}, {"scale": {"m": 1}}):
        assert TrialStatement(None, {**USUAL, "plant": given}).changes.is_released


def test_a_file_is_read_and_options_replace_its_values(tmp_path: Path) -> None:
    file = tmp_path / "a.track.yaml"
    file.write_text("duration: 2\nrate: 10\nstart: {states: {free: 1}}\n", encoding="utf-8")
    trial, _ = TrialStatement(file, {"rate": "20"}).trial(PROBLEM, MANIFEST, {})
    assert (trial.duration, trial.period, np.isclose(trial.start_states[1], 1)) == (2.0, 0.05, True)
