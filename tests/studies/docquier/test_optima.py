"""The lowest optima of a record: with whole turns and without apart, each with its number of finds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from mbsrun.measuring.sections import Table
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.searching.search import Progress
from mbsrun.ocp.searching.study import Study
from mbsrun.ocp.solution.record import Attempt, Task, open_record
from mbsrun.ocp.solving.certificate import Certificate
from studies.docquier import optima
from studies.docquier.optima import describe_optima, list_optima, tabulate_optima
from studies.docquier.robustness import State, describe_lower, report_robust
from tests.mbsrun.ocp.plants import push
from tests.studies.docquier.made import SMOOTH, STUDY, make

CERTIFICATE = Certificate(1e-9, 1.0, 1e-9, 1e-9, 2, is_minimum=True)


def test_turned_optima_are_apart_and_finds_are_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of three bumps two end in the minimum; a turn leads lower at one target, and higher at the other."""
    study = replace(STUDY, costs=(SMOOTH,))
    certified = []

    def certify(*_: object) -> Certificate:
        certified.append(CERTIFICATE)
        return CERTIFICATE

    monkeypatch.setattr(Study, "state", lambda *_: None)
    monkeypatch.setattr(optima, "structure", lambda _: "one")
    monkeypatch.setattr(optima, "Solver", lambda *_: None)
    monkeypatch.setattr(optima, "certify_motion", certify)
    monkeypatch.setattr(optima, "list_turning", lambda *_: (0,))
    plant = cast(Any, SimpleNamespace(manifest=None))
    names = iter(f"{k}" for k in range(8))  # of four certificates, then of the same three and another one
    again = [*map(str, range(4)), "0", "1", "2", "other"]
    monkeypatch.setattr(optima, "_name", lambda *_: again[int(next(names))])
    shapes = ((2,), (2, 1), (2, 1), (1, 1), (1, 1), (1, 1, 1), (1, 1, 1), (1, 1, 1))
    motion = Trajectory(*map(np.zeros, shapes))
    with open_record(tmp_path / "study.sqlite", "one") as record:
        for k, (place, part, cost, turns) in enumerate(
            (
                (0, "paper", 5.0, ""),
                (0, "bumps", 4.0, ""),
                (0, "bumps", 4.0, ""),
                (0, "bumps", 6.0, ""),
                (0, "turns", 3.0, "q1 -1"),
                (0, "turns", 3.5, "q1 +1"),
                (1, "paper", 4.0, ""),
                (1, "turns", 9.0, "q1 -1"),
            )
        ):
            protocol = "paper" if part == "paper" else "robust"
            task = Task((place, 0), SMOOTH, "IMPL")
            numbers = (0, "", 20, 1.0, 0.5, cost)
            record.add(Attempt(task, protocol, part, str(k), *numbers, turns=turns), motion)
        found = list(list_optima(study, record, plant, lambda *_: None))
        assert list(list_optima(study, record, plant, lambda *_: None)) == found
        monkeypatch.setattr(optima, "_name", lambda *_: "new")
        late = list(list_optima(study, record, plant, lambda *_: None, end=0.0))
    assert len(certified) == 5, "the second time, only what has changed is checked again"
    assert [(o.task.place[0], o.turns, o.cost, o.found, o.tried, o.hits, o.starts) for o in found] == [
        (0, "", 4.0, 0, 1, 2, 3),
        (0, "q1 -1", 3.0, 0, 1, 1, 2),
        (1, "", 4.0, 1, 1, 0, 0),
        (1, "q1 -1", 9.0, 0, 1, 1, 1),
    ]
    assert [o.certificate for o in late] == [o.beyond for o in late] == [None] * 4
    assert [o.beyond for o in found] == [0.0] * 4
    assert "hold at 0 of 2 lowest optima (2 were not checked)" in describe_optima(study, late, "optima.csv").text
    assert [row[-1] for row in tabulate_optima(study, late).rows] == [optima.UNCHECKED] * 4
    text = describe_optima(study, found, "optima.csv").text
    assert "hold at 2 of 2 lowest optima" in text
    assert "found them 2 times of 3, and never at 0 of 1 targets" in text
    assert "In 0 of them a joint without limits goes more than half a turn" in text
    assert "found at 2 targets, and are lower at 1 of them" in text
    table = tabulate_optima(study, found)
    assert [row[table.columns.index("whole turns")] for row in table.rows] == ["none", "q1 -1"] * 2


def test_turns_beyond_start_and_end_are_those_of_the_farthest_joint() -> None:
    """Of two joints, one goes half a turn below its start, one a tenth above its end; a third is not asked for."""
    q = 2 * np.pi * np.array([[0.0, 0.2, 0.0], [-0.5, 0.5, 9.0], [0.25, 0.4, 0.0]])
    points = (np.zeros((2, 1, 3)),) * 3
    motion = Trajectory(np.zeros(3), q, np.zeros((3, 3)), np.zeros((2, 1)), np.zeros((2, 1)), *points)
    assert optima.measure_beyond(motion, (0, 1)) == pytest.approx(0.5)
    assert optima.measure_beyond(motion, (1,)) == pytest.approx(0.1)
    assert optima.measure_beyond(motion, ()) == 0.0


def test_a_certificate_depends_on_the_motion_the_problem_and_the_kernels() -> None:
    problem = push(4)
    motion = Trajectory(*map(np.zeros, ((2,), (2, 1), (2, 1), (1, 1), (1, 1), (1, 1, 1), (1, 1, 1), (1, 1, 1))))
    plant, other = (cast(Any, SimpleNamespace(manifest=SimpleNamespace(model_hash=x))) for x in ("a", "b"))
    names = [
        optima._name(problem, motion, plant),
        optima._name(problem, motion, other),
        optima._name(replace(problem, intervals=problem.intervals + 1), motion, plant),
        optima._name(problem, replace(motion, q=motion.q + 1e-16), plant),
    ]
    assert len(set(names)) == 4
    assert optima._name(problem, replace(motion, q=motion.q.copy()), plant) == names[0]


def test_what_the_robust_protocol_found_is_apart_from_the_verdicts() -> None:
    """Its lower minimum at one target makes no solve of the paper's protocol a higher one."""
    results = make()
    task = Task((2, 0), SMOOTH, "IMPL")
    found = [
        Attempt(task, "robust", part, "0", round_, "", 20, 1.0, 0.5, cost, turns=turns)
        for part, round_, cost, turns in (("waves", 0, 5.0, ""), ("hops", 1, 2.0, ""), ("turns", 0, 1.0, "q1 +1"))
    ]
    both = replace(results, attempts=(*results.attempts, *found))
    assert not any(both.higher(SMOOTH, name) for name in both.representations)
    assert both.lowest == results.lowest
    assert both.known[(2, 0), SMOOTH] == 2.0
    assert "lower by more than 1% at 1 of 1 targets, down to 0.4 of it, by 2 to 2 attempts" in describe_lower(both)
    section = report_robust(both, {SMOOTH: State(Progress(1, 9, 4, is_through=False), None)})
    assert section is not None
    rows = [item for item in section.items if item.title == "Minima below the paper's protocol"]
    assert isinstance(rows[0], Table)
    assert rows[0].rows == (("k1 = 1, k2 = 10", "2,0", 5.0, 2.0, "hops", 1, 0, 1, 1.0),)
