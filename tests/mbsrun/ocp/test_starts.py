"""Starts of a search: what they keep, that they can be made again, and that they find lower minima than the guess."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mbsrun.external import load_on_demand
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.guessing.guess import find_pose, interpolate, scatter_poses
from mbsrun.ocp.guessing.starts import (
    Kind,
    Variation,
    add_waves,
    coarsen,
    count_turns,
    describe_starts,
    describe_turns,
    list_turning,
    vary,
)
from mbsrun.ocp.problem.problem import Problem, Representation
from mbsrun.ocp.searching.attempts import (
    count_finds,
    describe_search,
    find_lowest,
    list_open_tasks,
    list_turned,
    summarise,
)
from mbsrun.ocp.searching.executor import Worker
from mbsrun.ocp.searching.multistart import gather, list_starts, state_study
from mbsrun.ocp.searching.search import Job
from mbsrun.ocp.searching.study import Targets
from mbsrun.ocp.searching.trials import COUNTS, plan_round, restate
from mbsrun.ocp.showing.pictures import plot_starts
from mbsrun.ocp.solution import record as records
from mbsrun.ocp.solution.record import Attempt, Best, Task, open_record
from mbsrun.ocp.solution.solution import Start, Starts
from mbsrun.ocp.statement.statement import read_problem
from studies.laboratory.optimisation import state_swing_up
from tests.mbsrun.ocp.conftest import MODELS
from tests.mbsrun.ocp.plants import push
from tests.mbsrun.peer import Peer, double_integrator

RADAU = schemes.build(schemes.Family.RADAU, 3)
TARGETS = Targets(0.64, (0.0, 0.02, 0.04), (0.0,), every=(3, 1))
KINDS: tuple[Kind, ...] = ("bumps", "noise", "waves", "branches", "turns")


@pytest.fixture(scope="module")
def coarse(reach: Problem) -> Problem:
    return replace(reach, intervals=6, degree=3)


@pytest.mark.parametrize("kind", KINDS)
def test_a_start_is_made_again_from_its_seed(arm: Peer, coarse: Problem, kind: Kind) -> None:
    """Bit by bit; another seed gives another motion. Coordinates and inputs lie within their bounds."""
    bounded = replace(coarse, bounds=replace(coarse.bounds, u=((-5.0, 5.0),) * 4))
    turn = (0, -1) if kind == "turns" else None
    first, again, other = (vary(Variation(kind, (k, 4), turn), bounded, arm, RADAU, (0, 1)) for k in (7, 7, 8))
    assert first is not None
    assert again is not None
    assert other is not None
    for name, values in vars(first).items():
        assert np.array_equal(values, getattr(again, name))
    assert not np.array_equal(first.point_q, other.point_q)
    assert (np.abs(first.u) <= 5.0).all()
    if kind != "bumps":  # which are small, and smooth
        lower, upper = np.array(bounded.bounds.q).T
        assert (first.point_q >= lower).all()
        assert (first.point_q <= upper).all()


def test_noise_is_at_every_point(arm: Peer, coarse: Problem) -> None:
    """No coordinate without bounds has the guess's value anywhere, and no interval its inputs."""
    guess = interpolate(coarse, RADAU, find_pose(coarse, arm).q)
    noisy = vary(Variation("noise", (1,)), coarse, arm, RADAU, ())
    assert noisy is not None
    assert (noisy.q[:, 0] != guess.q[:, 0]).all()
    assert (noisy.point_q[..., 0] != guess.point_q[..., 0]).all()
    assert (noisy.u != guess.u).all()


def test_waves_keep_both_ends_and_are_motions(coarse: Problem) -> None:
    """Coordinates without bounds: rates are the derivatives of their coordinates, to the error of the polynomials."""
    free = replace(coarse, intervals=100, bounds=replace(coarse.bounds, q=((-np.inf, np.inf),) * 6))
    scheme = schemes.build(schemes.Family.RADAU, 5)
    guess = interpolate(free, scheme, np.zeros(6))
    motion = add_waves(guess, free, np.random.default_rng(3))
    for name in ("q", "qd"):
        ends, kept = getattr(motion, name)[[0, -1]], getattr(guess, name)[[0, -1]]
        assert ends == pytest.approx(kept, abs=1e-9)
    assert motion.point_qdd[-1, -1] == pytest.approx(guess.point_qdd[-1, -1], abs=1e-7)
    assert (np.abs(motion.q - guess.q).max(axis=0) > 0.1).all()
    for name, rate in (("q", "qd"), ("qd", "qdd")):
        nodes = np.concatenate((getattr(motion, name)[:-1, None], getattr(motion, f"point_{name}")), axis=1)
        slopes, rates = scheme.D @ nodes / motion.t[1], getattr(motion, f"point_{rate}")
        assert slopes == pytest.approx(rates, abs=1e-4 * np.abs(rates).max())


def test_branches_meet_the_target_by_other_poses(arm: Peer, coarse: Problem) -> None:
    found = [scatter_poses(coarse, arm, np.random.default_rng(k), 20) for k in range(3)]
    ((_, target),) = coarse.end.sensors
    for q in found:
        assert q is not None
        places = arm("frames", q=q)["p"]
        (hand,) = (i for i, frame in enumerate(arm.manifest.frames) if frame.sensor and frame.name == "hand")
        assert places[:, hand] == pytest.approx(target, abs=1e-5)
    assert max(np.abs(q - found[0]).max() for q in found if q is not None and found[0] is not None) > 0.1


def test_whole_turns_are_of_joints_without_limits_and_counted(arm: Peer, coarse: Problem) -> None:
    """Joint 1 of the arm alone; a bound or a value at the end leaves it no turns. Quarter turns are none."""
    assert list_turning(coarse, arm.manifest) == (0,)
    for bound in ((-9.0, np.inf), (-np.inf, 9.0)):
        bounded = replace(coarse, bounds=replace(coarse.bounds, q=(bound, *coarse.bounds.q[1:])))
        assert list_turning(bounded, arm.manifest) == ()
    fixed = replace(coarse, end=replace(coarse.end, coordinates=((0, 1.0),)))
    assert list_turning(fixed, arm.manifest) == ()
    assert list_turning(push(4), double_integrator().manifest) == ()  # it slides
    pose = find_pose(coarse, arm).q
    for turns, told in ((0, ""), (2, "q1 +2"), (-1, "q1 -1")):
        q = pose + 2 * np.pi * turns * np.eye(6)[0]
        assert count_turns(interpolate(coarse, RADAU, q), coarse, arm.manifest) == told
    turned = vary(Variation("turns", (1,), (0, 2)), coarse, arm, RADAU, ())
    assert turned is not None
    assert describe_turns("q1 +2, q5 -1") == "with +2 turns of q1, with -1 turn of q5"


def test_a_fine_mesh_is_made_coarse(reach: Problem) -> None:
    """For a first solve, to a half or a fifth; not for bumps, which are smooth, nor where there is little to gain."""
    found = [coarsen(reach, Variation("noise", (0, k))) for k in range(10)]
    assert {(problem.intervals, problem.degree) for problem in found if problem is not None} == {(50, 3), (20, 3)}
    assert coarsen(reach, Variation("bumps", (0, 1))) is None
    assert coarsen(replace(reach, intervals=39), Variation("noise", (0, 1))) is None


def test_more_starts_begin_with_the_same(arm: Peer, coarse: Problem) -> None:
    """Start k follows from the seed and k. All kinds take part, each joint that turns by every number of turns."""
    study = state_study(coarse, arm)
    many = list_starts(study, 3, 40)
    assert many[:12] == list_starts(study, 3, 12)
    assert many[0].part == "guess"
    assert {trial.part for trial in many} == {"guess", *KINDS}
    assert len({trial.key for trial in many}) == 40
    turns = {trial.start.variation.turn for trial in many if trial.part == "turns"}  # type: ignore[union-attr]
    assert turns >= {(0, 1), (0, -1), (0, 2), (0, -2)}
    assert not {t.key for t in list_starts(study, 4, 40)[1:]} & {t.key for t in many[1:]}


def test_the_robust_protocol_tries_all_kinds(arm: Peer, coarse: Problem) -> None:
    """As many as are listed, of each target; more of them where input rates are free."""
    study = replace(state_study(coarse, arm), costs=((1.0, 0.0), (1.0, 10.0)), turning=(0,))
    trials = plan_round(study, "robust", 0, {}, ())
    for rough, weights in enumerate(study.costs):
        for part, counts in COUNTS.items():
            own = [trial for trial in trials if trial.part == part and trial.task.weights == weights]
            assert len(own) == counts[rough] * (4 if part == "turns" else 1)
            assert len({trial.start.variation for trial in own}) == len(own)  # type: ignore[union-attr]


def test_any_part_of_the_random_starts_is_spread_over_targets_and_kinds(arm: Peer, coarse: Problem) -> None:
    """The first of each kind at every target come before the second of any."""
    targets = Targets(0.5, (0.0, 0.5, 1.0), (0.0,))
    study = replace(state_study(coarse, arm), costs=((1.0, 0.0),), sensor="hand", targets=targets, turning=(0,))
    trials = [t for t in plan_round(study, "robust", 0, {}, ()) if t.part in COUNTS]
    first = trials[: 3 * (len(COUNTS) - 1 + 4)]  # whole turns come in four numbers
    assert all(trial.guess.split(" ")[-1] == "0" for trial in first)
    assert {t.task.place for t in first} == set(targets.places)
    assert {t.part for t in first} == set(COUNTS)
    assert len({t.key for t in trials}) == len(trials) == 3 * (6 + 6 + 8 + 2 + 4 * 2)


def test_a_trial_is_stated_again_from_its_names(arm: Peer, coarse: Problem) -> None:
    """Of every part: an attempt that was made elsewhere can be made again."""
    targets = Targets(0.5, (0.0, 0.5, 1.0), (0.0,))
    two = (Representation.IMPL, Representation.EXP1_O)
    study = replace(state_study(coarse, arm), sensor="hand", targets=targets, turning=(0,), representations=two)
    tasks = [Task(place, study.costs[0], two[0].value) for place in targets.places]
    higher = Task(tasks[0].place, study.costs[0], two[1].value)
    best = {task: Best(5.0 + k, 0) for k, task in enumerate(tasks)} | {higher: Best(9.0, 0)}
    turned = {tasks[1]: Best(4.0, 0, "q1 +1, q2 -1")}
    moves = plan_round(study, "robust", 3, best, (), turned)
    trials = [
        *plan_round(study, "paper", 0, {}, ()),
        *plan_round(study, "robust", 0, {}, ()),
        *moves,
        *plan_round(study, "robust", 3, best, {trial.key for trial in moves}, turned),
    ]
    parts = {"paper", "interpolation", *COUNTS, "neighbours", "hops", "exchange"}
    assert {trial.part for trial in trials} == parts
    for trial in trials:
        made = Attempt(trial.task, trial.protocol, trial.part, trial.guess, trial.round, "", 1, 0.1, 0.1, 1.0)
        assert restate(study, made) == trial


def attempt(part: str, cost: float | None, guess: str, turns: str = "", place: int = 0) -> Attempt:
    task = Task((place, 0), (1.0, 0.0), "IMPL")
    return Attempt(task, "robust", part, guess, 0, "status", 7, 1.0, 0.5, cost, turns=turns)


FOUND = [
    attempt("interpolation", 5.0, "dynamic"),
    attempt("noise", 4.0, "0"),
    attempt("noise", None, "1"),
    attempt("waves", 4.0 + 1e-7, "0"),
    attempt("turns", 1.0, "0 +1 0", "q1 +1"),
    attempt("turns", 6.0, "0 -1 0", "q1 -1"),
    attempt("neighbours", 4.0, "near"),
    attempt("noise", 3.0, "0", place=1),
    attempt("neighbours", 2.0, "near", place=1),
]


def test_what_was_found_is_counted_by_independent_starts(coarse: Problem, arm: Peer) -> None:
    """Neighbours are not independent; motions with whole turns are compared among themselves."""
    assert find_lowest(FOUND) == {((0, 0), (1.0, 0.0)): 4.0, ((1, 0), (1.0, 0.0)): 2.0}
    first, second = count_finds(FOUND)
    assert (first.found, first.starts) == (2, 4)
    assert (second.found, second.starts) == (0, 1)
    assert [(t.turns, t.cost, t.lowest) for t in list_turned(FOUND)] == [("q1 +1", 1.0, 4.0), ("q1 -1", 6.0, 4.0)]
    lines = describe_search(FOUND)
    assert "0 to 2 of 1 to 4 independent starts, at 1 of 2 targets by none; lower ones may exist" in lines[0]
    assert "lower still at 1 targets: down to 1, with +1 turn of q1, at target (0, 0)" in lines[1]
    lines = describe_search([*FOUND, attempt("turns", 2.0, "0 +2 0", "q1 +2")])
    assert "down to 1, with +1 turn of q1" in lines[1]  # the lowest of several
    study = replace(state_study(coarse, arm), costs=((1.0, 0.0),), targets=TARGETS)
    assert list_open_tasks(study, FOUND) == []
    assert len(list_open_tasks(study, [FOUND[4]])) == 1  # solved with whole turns alone


def test_failures_take_no_part_in_medians() -> None:
    """Of iterations and processor time: what ended without a solution counts in the sum alone."""
    task = Task((0, 0), (1.0, 0.0), "IMPL")
    solved = [Attempt(task, "paper", "paper", str(k), 0, "s", 10 + k, 1.0 + k, 0.5, 1.0) for k in range(3)]
    failed = [Attempt(task, "paper", "paper", f"f{k}", 0, "f", 500, 90.0, 0.5, None) for k in range(5)]
    (summary,) = summarise([*solved, *failed])
    assert (summary.attempts, summary.solved) == (8, 3)
    assert summary.iterations == (10, 11, 12)
    assert summary.cpu_median == 2.0
    assert summary.cpu_seconds == 6.0 + 450.0
    (none,) = summarise(failed)
    assert (none.solved, none.iterations, none.cpu_median) == (0, (0, 0, 0), 0)


def start(number: int, cost: float | None, turns: str = "", kind: str = "noise") -> Start:
    return Start(number, kind, "status", 5, 1.0, cost, turns)


def test_what_many_starts_found_is_told_as_it_is(tmp_path: Path) -> None:
    """Costs that differ by rounding are one; with other turns they are not."""
    starts = Starts(
        0, 9, (start(0, 3.0, kind="guess"), start(1, None), start(2, 2.0, "q1 +1"), start(3, 2.0), start(5, 2.0 + 1e-7))
    )
    assert [(m.cost, m.turns, m.found) for m in starts.minima] == [(2.0, "", 2), (2.0, "q1 +1", 1), (3.0, "", 1)]
    assert starts.best == start(2, 2.0, "q1 +1")
    assert describe_starts(replace(starts, results=starts.results[:2])).startswith(
        "the lowest cost was found once in 2"
    )
    assert describe_starts(replace(starts, results=())) == "no solution in 0 starts"
    plot_starts(starts, tmp_path / "starts.png")
    assert (tmp_path / "starts.png").stat().st_size > 5000


def search(problem: Problem, plant: Plant, count: int) -> Starts:
    study, worker = state_study(problem, plant), Worker(plant)
    trials = list_starts(study, 0, count)
    return gather(trials, [worker.carry_out(Job(study, trial, None)).attempt for trial in trials], 0)


def test_a_record_of_before_goes_on(tmp_path: Path, coarse: Problem) -> None:
    """The tables of the format before, with one attempt: it is there, without turns, and its motion with it."""
    path, task = tmp_path / "record", Task((0, 0), (1.0, 0.0), "IMPL")
    motion = interpolate(coarse, RADAU, np.arange(6.0))
    made = Attempt(task, "robust", "bumps", "0", 0, "Solve_Succeeded", 7, 1.0, 0.5, 4.0)
    with open_record(path, "study") as record:
        record.add(made, motion, "machine")
    with sqlite3.connect(path) as connection:
        for table in ("attempts", "best"):
            connection.execute(f"alter table {table} drop column turns" if table == "attempts" else "select 1")
        old = "study, place_i, place_j, inputs, input_rates, representation, protocol, round"
        connection.executescript(
            f"create table former as select {old}, cost, motion from best; drop table best; "
            f"alter table former rename to best; update about set format = '{records.BEFORE}';"
        )
    with open_record(path, "study") as record:
        assert list(record.attempts()) == [made]
        kept = record.best_motion(task, "robust")
        assert kept is not None
        assert np.array_equal(kept.point_q, motion.point_q)
        turned = replace(made, guess="1", cost=1.0, turns="q1 +1")
        assert record.add(turned, motion, "machine")
        assert record.best("robust")[task].cost == 4.0
        assert record.best_motion(task, "robust", turns="q1 +1") is not None
    with open_record(path, "study") as record:
        assert list(record.attempts()) == [made, turned]


def test_starts_find_what_the_guess_misses_on_two_links(requires: Callable[[str], str]) -> None:
    """The fastest motion to a place behind the shoulder: IMPL ends 7 % high from the guess, 0.7096 s is known."""
    requires("cc")
    problem, plant = read_problem(MODELS / "planar_arm_fastest.ocp.yaml", load_on_demand)
    found = search(replace(problem.with_target("hand", (-0.4, -0.2, 0.0)), intervals=24), plant, 12)
    assert found.results[0].cost is not None
    assert found.best is not None
    assert found.best.cost is not None
    assert found.results[0].cost > 1.07 * found.best.cost
    assert found.best.cost <= 0.7096 * (1 + 1e-3)


def test_starts_find_what_the_guess_misses_on_an_acrobot(requires: Callable[[str], str]) -> None:
    """Three times lower and more than IPOPT, by the first few; the problem that ships, at a lower degree."""
    requires("cc")
    problem, plant = read_problem(MODELS / "acrobot_swing_up.ocp.yaml", load_on_demand)
    problem = replace(problem, intervals=80, degree=3, solver=replace(problem.solver, method="ipopt"))
    found = search(problem, plant, 6)
    assert found.results[0].cost is not None
    assert found.best is not None
    assert found.best.cost is not None
    assert found.results[0].cost > 3 * found.best.cost


def test_starts_reach_the_better_basin_of_the_swing_up(requires: Callable[[str], str]) -> None:
    """From the guess and from bumps IPOPT ends in the upper of two minima that are 1.3 % apart."""
    requires("cc")
    _, plant = read_problem(MODELS / "cart_pole_swing_up.ocp.yaml", load_on_demand)
    found = search(state_swing_up(25, 3), plant, 20)
    costs = {start.kind: [] for start in found.results}  # type: dict[str, list[float]]
    for start_ in found.results:
        if start_.cost is not None:
            costs[start_.kind].append(start_.cost)
    assert min(costs["noise"] + costs["waves"]) < 0.992 * costs["guess"][0]
    assert min(costs["bumps"]) > 0.999 * costs["guess"][0]
    assert found.times >= 2
