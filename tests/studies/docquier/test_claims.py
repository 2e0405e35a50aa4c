"""Each statement of the paper against results that confirm it and that refute it; thresholds and scatter.

Every judge gets at least one set of results for each verdict, so a judge that compares the wrong way, the wrong
representations, the wrong cost or the wrong number fails here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from mbsrun.measuring.sections import Picture
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.solution.record import Attempt, Task
from studies.docquier import spread
from studies.docquier.campaign import describe_missing
from studies.docquier.claims import CLAIMS
from studies.docquier.differentiated import WAYS
from studies.docquier.growth import Growth
from studies.docquier.judgement import INSIDE, THRESHOLDS, TURNS, UNMEASURED, judge_all, write_thresholds
from studies.docquier.judges import COLLOCATION, CONFIRMED, REFUTED, Finding
from studies.docquier.questions import answer_derivatives, summarise_derivatives
from studies.docquier.results import Effort, Results, find_outliers
from studies.docquier.summary import summarise_run
from tests.studies.docquier.made import NAMES, PLACES, ROUGH, SMOOTH, TARGETS, Number, make

IMPLICIT, ODE, DAE = ("IMPL", "SEMI"), ("EXP1-O", "EXP2-O"), ("EXP1-A", "EXP2-A")
CENTRE = 4

Solve = tuple[float, float, float]  # cost, iterations, CPU time


def at(
    *cases: tuple[tuple[float, float] | None, Sequence[str] | None, Sequence[int] | None, float], rest: float
) -> Number:
    """Return a number by cost, representations and places; None stands for all of them."""

    def number(weights: tuple[float, float], name: str, place: int) -> float:
        for w, names, places, value in cases:
            if w in (None, weights) and (names is None or name in names) and (places is None or place in places):
                return value
        return rest

    return number


def move(u: Sequence[Sequence[float]], qd: float = 1.0, end: float = 0.0) -> Trajectory:
    """Make a motion of one joint with inputs (N, 1), a largest velocity, and a pose at the end."""
    inputs = np.array(u, dtype=float)
    N = len(inputs)
    q, v = np.zeros((N + 1, 1)), np.zeros((N + 1, 1))
    q[-1], v[1] = end, qd
    points = np.zeros((N, 1, 1))
    return Trajectory(np.linspace(0, 1, N + 1), q, v, inputs, np.zeros((N, 1)), points, points, points)


def moved(rough: Trajectory, smooth: Trajectory) -> Results:
    return replace(make(), motions=((ROUGH, rough), (SMOOTH, smooth)))


def counted(**flops: int) -> Results:
    return replace(make(), efforts=tuple((name, Effort(count, 1)) for name, count in flops.items()))


def grown(exp1: Sequence[int], exp2: Sequence[int]) -> Results:
    sizes = (4, 8, 12, 16, 24)
    pairs = (("EXP1", exp1), ("EXP2", exp2))
    return replace(make(), growth=tuple(Growth(n, tuple(zip(sizes, f, strict=True)), 1) for n, f in pairs))


def shot(collocation: Sequence[Solve | None], shooting: Sequence[Solve | None]) -> Results:
    def list_attempts(solves: Sequence[Solve | None]) -> tuple[Attempt, ...]:
        task = Task((0, 0), SMOOTH, "EXP2-O")
        told = ("question", "shooting", "dynamic", 0, "")
        return tuple(
            Attempt(task, *told, 9, 1.0, 0.5, None) if s is None else Attempt(task, *told, int(s[1]), s[2], 0.5, s[0])
            for s in solves
        )

    return replace(make(), shooting=((COLLOCATION, list_attempts(collocation)), ("shooting", list_attempts(shooting))))


ONE, SLOW = (5.0, 20.0, 1.0), (5.0, 20.0, 3.0)
calm, wild = move([[0], [1], [2], [1]]), move([[0], [9]] * 8, qd=3.0)
ode_sizes = dict.fromkeys(ODE, (9, 9, 10, 10))

# statement -> results that confirm it; results that do not
CASES: dict[str, tuple[list[Results], list[Results]]] = {
    "refinement": (
        [make(), make(iterations=at((None, None, (1,), 22), rest=20))],
        [
            make(iterations=at((None, None, (1, 3, 5, 7), 60), rest=20)),
            make(iterations=at((ROUGH, ["SEMI"], (1, 3), 60), rest=20)),
        ],
    ),
    "smoother": ([moved(wild, calm)], [moved(calm, wild), moved(calm, calm)]),
    "effort": ([moved(calm, wild)], [moved(wild, calm)]),
    "oscillations": ([moved(wild, calm)], [moved(calm, wild)]),
    "speeds": ([moved(wild, calm)], [moved(calm, wild)]),
    "same-end": (
        [moved(calm, calm)],
        [moved(calm, move([[0], [1], [2], [1]], end=1e-3)), moved(calm, move([[0], [1], [2], [1.1]]))],
    ),
    "one-outlier": (
        [make(cost=at((SMOOTH, ["EXP2-O"], (3, 4), 6), rest=5))],
        [make(), make(cost=at((ROUGH, ["EXP2-O"], (3,), 6), rest=5)), make(cost=at((SMOOTH, ODE, (3,), 6), rest=5))],
    ),
    "fewer-minima": (
        [make(cost=at((ROUGH, ["SEMI"], (2,), 6), rest=5))],
        [make(), make(cost=at((SMOOTH, ["SEMI"], (2,), 6), rest=5))],
    ),
    "implicit-trapped": (
        [
            make(cost=at((ROUGH, IMPLICIT, (2,), 6), rest=5)),
            make(cost=at((ROUGH, ["SEMI"], (2, 3, 5), 6), (ROUGH, ODE, (1,), 6), rest=5)),
        ],
        [make(), make(cost=at((ROUGH, ODE, (2,), 6), rest=5)), make(cost=at((SMOOTH, IMPLICIT, (2,), 6), rest=5))],
    ),
    "sides-and-centre": (
        [make(cost=at((ROUGH, ["IMPL"], (0, 8), 6), rest=5)), make(cost=at((ROUGH, ["IMPL"], (CENTRE,), 6), rest=5))],
        [make(cost=at((ROUGH, ["IMPL"], (2,), 6), rest=5)), make(cost=at((ROUGH, ["IMPL"], (1, 2, 0), 6), rest=5))],
    ),
    "explicit-lower": (
        [make(cost=at((ROUGH, IMPLICIT, (2,), 6), rest=5))],
        [make(cost=at((ROUGH, ["IMPL", *ODE, *DAE], (2,), 6), rest=5))],
    ),
    "no-lateral-movement": (
        [make(iterations=at((ROUGH, None, (CENTRE,), 30), rest=20))],
        [make(), make(iterations=at((ROUGH, ["EXP2-A"], (CENTRE,), 10), (ROUGH, None, (CENTRE,), 30), rest=20))],
    ),
    "iteration-outliers": (
        [make(cost=at((ROUGH, NAMES[:5], (2,), 6), rest=5), iterations=at((ROUGH, None, (2,), 500), rest=20))],
        [
            make(cost=at((ROUGH, NAMES[:5], (3,), 6), rest=5), iterations=at((ROUGH, None, (2,), 500), rest=20)),
            make(cost=at((ROUGH, NAMES[:2], (2,), 6), rest=5), iterations=at((ROUGH, NAMES[:2], (2,), 500), rest=20)),
        ],
    ),
    "dae-iterations": (
        [make(iterations=at((ROUGH, DAE, None, 40), rest=20))],
        [
            make(iterations=at((ROUGH, ["EXP1-A"], None, 40), rest=20)),
            make(iterations=at((SMOOTH, DAE, None, 40), rest=20)),
        ],
    ),
    "implicit-iterations": (
        [make(iterations=at((SMOOTH, IMPLICIT, None, 20), rest=30))],
        [
            make(iterations=at((SMOOTH, ["IMPL"], None, 20), rest=30)),
            make(iterations=at((ROUGH, IMPLICIT, None, 20), rest=30)),
        ],
    ),
    "implicit-cpu-rough": (
        [make(cpu=at((ROUGH, IMPLICIT, None, 1), rest=2))],
        [make(cpu=at((SMOOTH, IMPLICIT, None, 1), rest=2)), make(cpu=at((ROUGH, ["SEMI"], None, 1), rest=2))],
    ),
    "implicit-cpu-smooth": (
        [make(cpu=at((SMOOTH, IMPLICIT, None, 1), rest=2))],
        [make(cpu=at((ROUGH, IMPLICIT, None, 1), rest=2)), make(cpu=at((SMOOTH, ["SEMI"], None, 1), rest=2))],
    ),
    "implicit-cpu-per-iteration-rough": (
        [make(cpu=at((ROUGH, IMPLICIT, None, 1), rest=2))],
        [make(cpu=at((ROUGH, IMPLICIT, None, 1), rest=2), iterations=at((ROUGH, IMPLICIT, None, 5), rest=20))],
    ),
    "implicit-cpu-per-iteration-smooth": (
        [make(cpu=at((SMOOTH, IMPLICIT, None, 1), rest=2))],
        [make(cpu=at((SMOOTH, IMPLICIT, None, 1), rest=2), iterations=at((SMOOTH, IMPLICIT, None, 5), rest=20))],
    ),
    "ode-iterations": (
        [make(iterations=at((ROUGH, ODE, None, 20), rest=30))],
        [
            make(iterations=at((ROUGH, ["EXP1-O"], None, 20), rest=30)),
            make(iterations=at((SMOOTH, ODE, None, 20), rest=30)),
        ],
    ),
    "ode-iterations-unclear": (
        [make(), make(iterations=at((SMOOTH, ["EXP1-O"], None, 20), rest=30))],
        [make(iterations=at((SMOOTH, ODE, None, 20), rest=30))],
    ),
    "explicit-cpu-alike": (
        [make(), make(cpu=at((None, ODE, None, 1.0), rest=1.2))],
        [make(cpu=at((SMOOTH, ["EXP1-A"], None, 2), rest=1)), make(cpu=at((ROUGH, ["EXP2-O"], None, 2), rest=1))],
    ),
    "order-n-dae-per-iteration": (
        [make(cpu=at((None, ["EXP2-A"], None, 1), rest=2))],
        [make(cpu=at((ROUGH, ["EXP2-A"], None, 1), rest=2)), make(cpu=at((None, ["EXP1-A"], None, 1), rest=2))],
    ),
    "order-n-iterations": (
        [make(iterations=at((None, ["EXP2-A"], None, 30), rest=20))],
        [
            make(iterations=at((SMOOTH, ["EXP2-A"], None, 30), rest=20)),
            make(iterations=at((None, ["EXP2-A"], None, 30), rest=20), cpu=at((ROUGH, ["EXP2-A"], None, 0.9), rest=1)),
        ],
    ),
    "dae-larger": (
        [make(sizes=lambda name: ode_sizes.get(name, (10, 10, 10, 10)))],
        [make(), make(sizes=lambda name: (9, 10, 10, 10) if name in ODE else (10, 10, 10, 10))],
    ),
    "nonzeros": (
        [make(sizes=lambda name: (9, 9, 7, 7) if name in IMPLICIT else (9, 9, 8, 8))],
        [
            make(sizes=lambda name: (9, 9, 7, 8 if name == "SEMI" else 7)),
            make(sizes=lambda name: (9, 9, 8 if name == "SEMI" else 7, 7)),
        ],
    ),
    "flops-half": ([counted(IMPL=50, SEMI=100)], [counted(IMPL=70, SEMI=100), counted(IMPL=30, SEMI=100)]),
    "flops-exp1": ([counted(EXP1=120, SEMI=100)], [counted(EXP1=130, SEMI=100)]),
    "flops-exp2": ([counted(EXP2=401, IMPL=100)], [counted(EXP2=400, IMPL=100)]),
    "crossing": (
        [grown((1, 2, 3, 5, 7), (2, 3, 2, 4, 6)), grown((1, 2, 3, 5, 7), (2, 3, 4, 4, 6))],
        [
            grown((1, 2, 3, 5, 7), (2, 1, 2, 4, 6)),
            grown((1, 2, 3, 5, 7), (2, 3, 4, 6, 8)),
            grown((1, 2, 3, 5, 7), (2, 3, 2, 6, 6)),
        ],
    ),
    "same-iterations": (
        [make(), make(iterations=at((ROUGH, ["IMPL"], None, 30), rest=20))],
        [make(iterations=at((SMOOTH, ["IMPL"], (1, 2), 21), rest=20))],
    ),
    "similar-iterations": (
        [make(iterations=at((ROUGH, ["IMPL"], (1,), 21), rest=20))],
        [make(), make(iterations=at((ROUGH, ["IMPL"], None, 40), rest=20))],
    ),
    "order-n-prefers-dae": (
        [make(cpu=at((None, ["EXP2-A", "EXP1-O"], None, 1), rest=2))],
        [
            make(cpu=at((ROUGH, ["EXP2-A", "EXP1-O"], None, 1), rest=2)),
            make(cpu=at((None, ["EXP2-A"], None, 1), rest=2)),
        ],
    ),
    "shooting": (
        [shot([ONE, ONE], [SLOW, None])],
        [shot([ONE, ONE], [SLOW, SLOW]), shot([ONE, ONE], [ONE, None]), shot([ONE, None], [SLOW, None])],
    ),
}


def judge(key: str, results: Results) -> str:
    finding = next(s for s in CLAIMS if s.key == key).judge(results)
    return UNMEASURED if finding is None else finding.verdict


@pytest.mark.parametrize("key", [s.key for s in CLAIMS])
def test_a_statement_is_confirmed_and_refuted_by_its_own_numbers(key: str) -> None:
    confirming, refuting = CASES[key]
    assert [judge(key, results) for results in confirming] == [CONFIRMED] * len(confirming)
    assert [judge(key, results) for results in refuting] == [REFUTED] * len(refuting)


def test_failures_count_in_no_median() -> None:
    whole = make()
    failed = [replace(a, cost=None, iterations=500) if a.task.place[0] < 3 else a for a in whole.attempts]
    results = replace(whole, attempts=tuple(failed))
    assert results.values(ROUGH, "IMPL", "iterations").tolist() == [20.0] * (PLACES - 3)


def test_keys_name_claims() -> None:
    assert len({s.key for s in CLAIMS}) == len({s.words for s in CLAIMS}) == len(CLAIMS) == len(CASES)


def test_a_run_without_a_solution_measures_nothing() -> None:
    empty = replace(make(), attempts=())
    failed = replace(make(), attempts=tuple(replace(a, cost=None, variables=None) for a in make().attempts))
    for results in (empty, failed):
        assert {j.verdict for j in judge_all(results)} == {UNMEASURED}


def test_a_verdict_that_turns_with_the_threshold_says_so() -> None:
    """IMPL is 0.5 % above the lowest cost: a higher minimum at 1e-6 to 1e-3, the same minimum at 1 % and 5 %."""
    judged = {j.claim.key: j for j in judge_all(make(cost=at((ROUGH, ["IMPL"], (0,), 5.025), rest=5)))}
    turned = judged["implicit-trapped"]
    assert turned.verdict == TURNS
    assert turned.by_threshold == (CONFIRMED, CONFIRMED, CONFIRMED, REFUTED, REFUTED)
    assert len(turned.by_threshold) == len(THRESHOLDS)
    assert "0.001: confirmed; 0.01: not confirmed" in write_thresholds(turned)
    assert judged["implicit-iterations"].verdict == REFUTED
    assert write_thresholds(judged["implicit-iterations"]) == ""


def repeat(results: Results, factor: float) -> Results:
    """Add repeats of every task, with iterations by `factor`, and the spread that they make."""
    repeats = [replace(a, part="repeats", iterations=round(factor * a.iterations)) for a in results.attempts]
    return replace(results, spreads=spread.measure(results.attempts, repeats, 1e-2))


def test_a_difference_inside_the_scatter_is_not_judged() -> None:
    """The implicit medians are 5 % lower; repeats differ by 1 %, or by half."""
    close = make(iterations=at((SMOOTH, IMPLICIT, None, 190), rest=200))
    for factor, verdict in ((1.01, CONFIRMED), (1.5, INSIDE)):
        found = {j.claim.key: j for j in judge_all(repeat(close, factor))}
        assert found["implicit-iterations"].verdict == verdict
        assert found["implicit-trapped"].share is None  # iterations do not decide it
    far = {j.claim.key: j for j in judge_all(repeat(make(iterations=at((SMOOTH, IMPLICIT, None, 20), rest=200)), 1.5))}
    assert far["implicit-iterations"].verdict == CONFIRMED
    assert far["ode-iterations"].share is not None


def test_spread_is_the_pooled_deviation_of_logarithms() -> None:
    """Two tasks: 10 and 20 iterations; 30, 30 and 60. A third was solved once, and does not count."""

    def solve(place: int, iterations: int, part: str, cost: float | None = 5.0) -> Attempt:
        return Attempt(Task((place, 0), ROUGH, "IMPL"), "paper", part, "zero", 0, "", iterations, 1.0, 0.5, cost)

    first = [solve(0, 10, "paper"), solve(1, 30, "paper"), solve(2, 999, "paper")]
    repeats = [
        solve(0, 20, "repeats"),
        solve(1, 30, "repeats"),
        solve(1, 60, "repeats", 5.2),
        solve(2, 1, "repeats", None),
    ]
    (found,) = spread.measure(first, repeats, 1e-2)
    logs = [np.log([10, 20]), np.log([30, 30, 60])]
    assert found.deviation == pytest.approx(np.sqrt(sum(((x - x.mean()) ** 2).sum() for x in logs) / 3))
    assert (found.tasks, found.solves, found.widest, found.apart) == (2, 5, 2.0, 1)


def test_only_what_all_representations_have_tried_is_compared() -> None:
    whole = make()
    cut = replace(
        whole, attempts=tuple(a for a in whole.attempts if a.task.representation != "EXP2-A" or a.task.place[0] == 1)
    )
    assert cut.compared == {SMOOTH: {(1, 0)}, ROUGH: {(1, 0)}}
    assert [a.task.place for a in cut.pick(ROUGH, "IMPL")] == [(1, 0)]


def test_outliers_are_the_paper_s() -> None:
    """A box from 2 to 4 has whiskers from -1 to 7 at most."""
    assert find_outliers(np.array([2.0, 2.0, 3.0, 4.0, 4.0, 7.0, 7.5])).tolist() == []
    values = np.array([1.0, 2.0, 2.0, 3.0, 3.0, 3.0, 4.0, 4.0, 5.0, 7.1])
    lower, upper = np.percentile(values, (25, 75))
    assert find_outliers(values).tolist() == [v for v in values if abs(v - (lower + upper) / 2) > 2 * (upper - lower)]
    assert find_outliers(np.array([])).size == 0


@pytest.mark.parametrize(
    ("cost", "iterations", "expected"),
    [
        (lambda *_: 5.0, lambda w, _, place: 20 + place * (w == ROUGH), {ROUGH}),  # rounding is mirrored with SMOOTH
        (lambda *_: 5.0, lambda *_: 20, set()),
        (lambda _w, _name, place: 5.0 + place, lambda _w, _name, place: 20 + place, set()),  # no mirror images
    ],
)
def test_mirror_images_take_the_place_of_repeats_where_they_differ_by_rounding(
    cost: Number, iterations: Number, expected: set[tuple[float, float]]
) -> None:
    images = spread.pair_mirrored(make(cost, iterations).attempts, TARGETS)
    assert {a.task.weights for a in images} == expected
    assert {a.task.place[0] for a in images} <= set(range(CENTRE + 1, PLACES))
    assert len(images) == CENTRE * len(NAMES) * len(expected)


def test_sources_of_derivatives_are_compared_in_one_sentence() -> None:
    """The quickest rounds count: 10 of 20 ms an iteration are evaluation by us, 20 of 30 or 40 of 50 by CasADi."""

    def solve(name: str, way: str, k: int, seconds: float, evaluating: float) -> Attempt:
        task = Task((0, 0), SMOOTH, name)
        return Attempt(task, "question", "derivatives", f"{way}, round {k}", k, "", 10, seconds, evaluating, 5.0)

    attempts = [
        solve("IMPL", WAYS[0], 0, 0.9, 0.5),
        solve("IMPL", WAYS[0], 1, 0.2, 0.1),
        solve("IMPL", WAYS[1], 0, 0.3, 0.2),
        solve("SEMI", WAYS[0], 0, 0.2, 0.1),
        solve("SEMI", WAYS[1], 0, 0.5, 0.4),
    ]
    section = answer_derivatives(attempts, {})
    assert section is not None
    assert section.text == (
        "Of the same equations: by CasADi's AD, compiled, functions and derivatives take 2 to 4 times the time of the "
        "generated ones, and the whole solve 1.5 to 2.5 times."
    )
    assert isinstance(section.items[0], Picture)
    answer = summarise_derivatives(attempts)
    assert answer is not None
    assert answer[0].endswith(
        "beside the generated functions and derivatives, CasADi's AD, compiled, takes 2 to 4 times as long, and is "
        "slower in 2 of 2 representations (whole solves: 1.5 to 2.5 times)."
    )
    assert summarise_run(make(), [], answer).items[0] == answer[1]
    slower = [*attempts, solve("EXP1-O", WAYS[0], 0, 0.2, 0.1), solve("EXP1-O", WAYS[1], 0, 0.2, 0.05)]
    assert "Not always" in (summarise_derivatives(slower) or ("",))[0]
    assert summarise_derivatives([]) is None


def test_costs_are_compared_on_the_targets_that_both_have() -> None:
    """Of a record in which one cost is not complete, higher minima elsewhere do not count; a sentence says so."""
    whole = make(cost=at((SMOOTH, ("EXP1-O",), (0, 1), 6.0), (ROUGH, ("IMPL",), (8,), 6.0), rest=5.0))
    part = replace(whole, attempts=tuple(a for a in whole.attempts if a.task.weights == SMOOTH or a.task.place[0] > 1))
    judge = next(claim.judge for claim in CLAIMS if claim.key == "fewer-minima")
    assert judge(whole) == Finding(REFUTED, "tasks in a higher minimum: 1 without smoothing, 2 with, of 54 each")
    assert judge(part) == Finding(CONFIRMED, "tasks in a higher minimum: 1 without smoothing, 0 with, of 42 each")
    assert describe_missing(whole) == ""
    assert "Verdicts with k1 = 1, k2 = 0 are of 7 of 9 targets" in describe_missing(part)
