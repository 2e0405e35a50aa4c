"""The C of a controller, read back: places, bounds, histories, options and numbers mean what the problem says."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mbsrun.controllers.arrays import INFINITE, Arrays, repeat, split, write_real
from mbsrun.controllers.making import choose_prediction
from mbsrun.controllers.writing import (
    Design,
    _describe_histories,
    choose_barrier,
    scale_cost,
    tag_names,
    write_files,
    write_short,
)
from mbsrun.ocp.evaluation.stages.calls import name_called
from mbsrun.ocp.evaluation.stages.tables import KernelFunction
from mbsrun.ocp.problem.problem import Bounds, Cost, Delay, SolverOptions, Term
from tests.mbsrun.controllers.built import LATE, make
from tests.mbsrun.ocp.plants import push
from tests.mbsrun.peer import double_integrator


@cache
def design(name: str) -> Design:
    built, plant = make(name), double_integrator()
    given: Any = plant
    called = [name_called(x) for x in built.tables.functions if isinstance(x, KernelFunction)]
    manifest, known = plant.manifest, {kernel.name for kernel in plant.manifest.kernels}
    more = tuple(plant.describe(name) for name in dict.fromkeys(called) if name not in known)
    described = manifest.model_copy(update={"kernels": (*manifest.kernels, *more)})
    count = built.transcription.program.variables
    return Design(
        name="push", version="1.0", problem=built.problem, problem_hash="a" * 64, numbers={}, manifest=described,
        transcription=built.transcription, tables=built.tables, sources=built.find(built.problem),
        scales=np.ones(count), guess=np.array([1.0, 1 / 3]), plan=np.array([1.0, 1 / 3]),
        prediction=choose_prediction(given, built.tables),
    )  # fmt: skip


@cache
def write(name: str) -> dict[str, str]:
    return write_files(design(name), 7.123456789)


def read(text: str, name: str) -> list[float]:
    """Read the numbers of an array in C."""
    found = re.search(rf"\b{name}\[\d*\] = \{{([^}}]*)\}}", text)
    assert found is not None, name
    return [float(word) for word in found[1].split(",")]


def define(text: str, name: str) -> float:
    found = re.search(rf"#define push_{name} (\S+)", text)
    assert found is not None, name
    return float(found[1])


@pytest.mark.parametrize("name", ["late", "free time"])
def test_stages_read_their_bounds_from_the_numbers(name: str) -> None:
    own, text = design(name), write(name)["push_tables.c"]
    tables, sources = own.tables, own.sources
    kinds = [tables.kinds[k] for k in tables.kind_of_stage]
    variables, rows = [kind.nx + kind.nv for kind in kinds], [kind.ng for kind in kinds]
    shapes = re.findall(r"\{(\d+), (\d+), (push_t\d+|NULL)\}", text[text.index("push_bounds push_bound[]") :])
    at, seen = np.zeros(2, dtype=int), []
    for k in map(int, read(text, "push_bound_of_stage")):
        count, inequalities, array = shapes[k]
        found = read(text, array)
        stage = len(seen)
        assert (int(count), int(inequalities)) == (variables[stage], rows[stage])
        parts = [*([part[at[0] : at[0] + variables[stage]] for part in (sources.lower, sources.upper)])]
        parts += [part[at[1] : at[1] + rows[stage]] for part in (sources.least, sources.most)]
        assert found == np.concatenate(parts).tolist()
        at += variables[stage], rows[stage]
        seen.append(k)
    assert len(seen) == len(kinds)
    header = write(name)["push_tables.h"]
    assert [define(header, x) for x in ("NUMBERS", "DATA", "VARIABLES", "INEQUALITIES")] == [
        sources.values.size, sources.count, sum(variables), sum(rows)
    ]  # fmt: skip
    assert read(text, "push_parameter_from") == sources.parameters.tolist()
    assert read(text, "push_numbers") == [float(write_real(x)) for x in sources.values]
    assert read(text, "lower") == [float(write_real(x)) for x in sources.values[sources.lower]]
    assert read(text, "most") == [float(write_real(x)) for x in sources.values[sources.most]]


def test_patterns_are_written_by_columns() -> None:
    """Of each kind of stage the Jacobians of equations, continuity and inequalities, and the Hessian."""
    text, tables = write("late")["push_tables.c"], design("late").tables
    for shape, kind in zip(
        re.findall(r"\{\{(\d+, \d+, \d+, \d+, \d+), (push_t\d+)\}", text), tables.kinds, strict=True
    ):
        assert shape[0] == f"{kind.nx}, {kind.nv}, {kind.ne}, {kind.ng}, {kind.inner}"
        found = re.search(rf"{shape[1]}\[1\] = \{{\s+\{{(.*)\}}", text)
        assert found is not None
        names = re.findall(r"\{(push_t\d+), (push_t\d+)\}", found[1])
        for (column, row), pattern in zip(names, (kind.de, kind.dd, kind.dg, kind.hessian), strict=True):
            counts = np.diff(read(text, column))
            assert len(counts) == pattern.shape[1]
            entries = sum(int(x) for x in counts)
            rows = np.array(read(text, row)[:entries], dtype=int)
            assert np.repeat(np.arange(len(counts)), counts.astype(int)).tolist() == pattern.col.tolist()
            assert rows.tolist() == pattern.row.tolist()


@pytest.mark.parametrize("name", ["late", "free time"])
def test_states_and_inputs_are_found_among_the_variables_of_a_stage(name: str) -> None:
    """Inputs of the model before controls; none at the end; a fixed horizon is nowhere."""
    own, text = design(name), write(name)["push_tables.c"]
    layout, tables = own.transcription.layout, own.tables
    rows = re.findall(r"\{(push_t\d+), (push_t\d+|NULL), (-?\d+)\}", text[text.index("push_places push_place[]") :])
    sizes = [kind.nx + kind.nv for kind in (tables.kinds[k] for k in tables.kind_of_stage)]
    firsts = np.cumsum([0, *sizes])
    states, inputs = len(own.problem.states), np.hstack((layout.inputs, layout.extras.controls))
    for k, row in enumerate(map(int, read(text, "push_place_of_stage"))):
        variables = tables.variables[firsts[k] : firsts[k + 1]]
        state, given, horizon = rows[row]
        expected = [*layout.mesh[k], *layout.extras.states[k, :states]]
        assert variables[[int(i) for i in read(text, state)]].tolist() == expected
        if k < own.problem.intervals:
            assert variables[[int(i) for i in read(text, given)]].tolist() == inputs[k].tolist()
        else:
            assert given == "NULL"
        assert (horizon == "-1") is (layout.horizon is None)
        if layout.horizon is not None:
            assert variables[int(horizon)] == layout.horizon


def test_commands_move_up_and_bound_the_input_that_is_given_now() -> None:
    """It acts two intervals later, where its rate counts from the latest command."""
    own, text = design("late"), write("late")["push.c"]
    place, tables = own.sources.place, own.tables
    before, given = place("inputs_before"), place("inputs_given")
    (acting,) = re.findall(r"acting\[\] = \{ ([\d, ]+) \}", text)
    layout = own.transcription.layout
    places = [int(i) for i in acting.split(",")]
    assert tables.variables[places].tolist() == [layout.inputs[2, 0], *layout.extras.controls[0]]
    limit = f"limit_rate(c, {places[0]}, c->numbers[{before + 1}], "
    limit += f"c->numbers[{place('input_rates_lower')}], c->numbers[{place('input_rates_upper')}]);"
    assert text.count("limit_rate(c, ") == 1
    assert limit in text
    assert f"memmove(c->numbers + {before}, c->numbers + {before + 1}, 1 * sizeof(real));" in text
    assert f"c->numbers[{before + 1}] = c->numbers[{given}];" in text
    assert "acting[]" not in write("free time")["push.c"]


def test_histories_of_several_inputs_lie_one_after_the_other() -> None:
    """Two commands of the first, one of the second, whose rate alone is bounded; inputs are numbered by stage."""
    free = (-np.inf, np.inf)
    problem = replace(
        push(4), delays=(Delay("input", 0, 0.5),), bounds=Bounds((free,), (free,), (free,) * 2, (free, (-1.0, 1.0)))
    )  # fmt: skip
    places = {"inputs_before": 10, "inputs_given": 20, "input_rates_lower": 30, "input_rates_upper": 40}
    layout = SimpleNamespace(inputs=np.arange(8).reshape(4, 2), extras=SimpleNamespace(controls=np.zeros((4, 0), int)))
    own: Any = SimpleNamespace(
        problem=problem, sources=SimpleNamespace(place=places.__getitem__),
        transcription=SimpleNamespace(layout=layout), tables=SimpleNamespace(variables=np.arange(8)[::-1]),
    )  # fmt: skip
    found = _describe_histories(own)
    assert found is not None
    assert [(x.place, x.second, x.last, x.kept, x.given) for x in found.inputs] == [
        (10, 11, 11, 1, 20),
        (12, 13, 12, 0, 21),
    ]
    assert [(x.variable, x.before, x.lower, x.upper) for x in found.limits] == [(6, 12, 30, 40)]
    assert (found.given, found.acting) == (20, (2, 0))


def test_a_model_predicts_from_a_state_that_holds_its_coordinates_first() -> None:
    text = write("free time")["push.c"]
    assert "arguments[0] = state;" in text
    assert "arguments[1] = state + 1;" in text
    assert "arguments[2] = inputs;" in text
    assert "memcpy(rates, state + 1, 1 * sizeof(real));" in text
    without = write_files(replace(design("free time"), prediction=()), 1.0)["push.c"]
    assert "arguments[0] = state;" not in without


def test_calls_have_room_for_the_most_arguments_and_results() -> None:
    tables = design("late").tables
    calls = [
        step.call for kind in tables.kinds for script in kind.scripts for step in script.steps if step.call is not None
    ]
    found = re.search(r"functions,\s+(\d+), (\d+), 0, 0\s*\}", write("late")["push_tables.c"])
    assert found is not None
    most = max(len(call.arguments) for call in calls), max(len(call.results) for call in calls)
    assert (int(found[1]), int(found[2])) == most


def test_numbers_of_the_folder() -> None:
    """The cost to 7 digits, the first guess exactly, the plan to 5, and every tenth of the plan in print."""
    files = write("late")
    assert "#define COST 7.123457\n" in files["push_check.c"]
    plan, guess = re.findall(r"push_guess\[\] = \{\s+([^}]*?)\s+\}", files["push_guess.c"])
    assert [plan, guess] == ["1.0, 0.33333", "1.0, 0.3333333333333333"]
    for intervals, stride in ((4, 1), (9, 1), (20, 2), (39, 3)):
        own = design("free time")
        changed = replace(own, problem=replace(own.problem, intervals=intervals))
        assert f"k <= push_INTERVALS; k += {stride})" in write_files(changed, 1.0)["push_main.c"]
    assert write_short(123456.7) == "123460.0"


def test_usual_sizes_are_written_unless_all_are_1() -> None:
    scales = np.ones(design("late").scales.size)
    assert ".scale" not in write("late")["push_tables.c"]
    scales[3] = 2.0
    text = write_files(replace(design("late"), scales=scales), 1.0)["push_tables.c"]
    assert read(text, "scale") == scales.tolist()


def test_options_are_the_ones_of_the_command() -> None:
    """A limit of time is the caller's; the acceptable tolerance is never below the tolerance."""
    options = (("mu_init", 0.125), ("max_wall_time", 3.0), ("warm_start_init_point", "yes"))
    for solver, expected, left in (
        (SolverOptions(), {"tol": "1e-08", "acceptable_tol": "1e-06", "max_iter": "500"}, "mu_init"),
        (SolverOptions(1e-4, 9), {"tol": "0.0001", "acceptable_tol": "0.0001", "max_iter": "9"}, "mu_init"),
        (
            SolverOptions(method="mbs", options=options),
            {"mu_init": "0.125", "warm_start_init_point": "1"},
            "max_wall_time = 3",
        ),
        (SolverOptions(method="ipopt", options=(("mu_init", 0.25),)), {"tol": "1e-08"}, "mu_init"),
    ):
        text = write_files(replace(design("late"), problem=replace(LATE, solver=solver)), 1.0)["push.c"]
        for name, value in expected.items():
            assert f"c->options.{name} = {value};" in text
        assert f"options.{left}" not in text


def test_the_cost_is_scaled_by_its_largest_weight_and_steps_stay_beside_its_optimum() -> None:
    problem = replace(push(4), cost=Cost(2.0, terminal=(Term("q_slide", -8.0),)))
    assert scale_cost(problem) == 0.125
    assert scale_cost(replace(problem, solver=SolverOptions(objective_scaling=3.0))) == 3.0
    assert choose_barrier(problem, -40.0) == pytest.approx(3e-4 * 0.125 * 40)
    assert choose_barrier(problem, 40.0, 0.5) == pytest.approx(2.5)
    header = write("late")["push.h"]
    assert define(header, "SCALE") == scale_cost(LATE)
    assert define(header, "BARRIER") == pytest.approx(3e-4 * scale_cost(LATE) * 7.123456789, rel=1e-5)


def test_arrays_that_are_equal_are_written_once() -> None:
    arrays = Arrays("a", lambda words: tuple(words))
    assert [arrays.integers([1, 2]), arrays.reals([1, 2]), arrays.integers([1, 2]), arrays.integers([])] == [
        "a_t0", "a_t1", "a_t0", "NULL"
    ]  # fmt: skip
    assert [x.declaration for x in arrays.declared] == [
        "static const int a_t0[2]",
        "static const mbs_stages_real a_t1[2]",
    ]
    found = repeat([np.array([1]), np.array([2]), np.array([1])], Arrays("b", lambda words: tuple(words)))
    assert (found.of_stage, found.names) == ((0, 1, 0), ("b_t0", "b_t1"))
    assert [x.tolist() for x in split(np.arange(5), [2, 0, 3])] == [[0, 1], [], [2, 3, 4]]


def test_a_bound_that_is_not_there_is_a_number_that_the_solver_takes_for_none() -> None:
    """At least 1e19, as mbs_stages.h says, and finite in single precision; patterns without an entry have a number."""
    assert [write_real(x) for x in (np.inf, -np.inf, 0.5)] == [repr(INFINITE), repr(-INFINITE), "0.5"]
    assert 1e19 <= INFINITE < np.finfo(np.float32).max
    assert re.search(r"push_t\d+\[0\] =", write("late")["push_tables.c"]) is None
    assert re.search(r"\{push_t\d+, NULL\}", write("late")["push_tables.c"]) is None


def test_only_names_at_the_beginning_are_tagged() -> None:
    found = tag_names(["push", "push_of_push"], "push", "push_123")
    assert [name for name, _ in found] == ["push", "push_of_push"]
    assert all(text.count("push_123") == 1 for _, text in found)
