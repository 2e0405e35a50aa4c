"""Searches over a grid of targets: what they try, what they keep, and that they go on where they were."""

from __future__ import annotations

import io
import json
import sqlite3
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from mbsgen.errors import InputError
from mbsrun.kernel import KernelError, Place
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.ground.status import UNREACHABLE
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.guessing.guess import bump, interpolate
from mbsrun.ocp.guessing.mirror import find_mirror, reflect
from mbsrun.ocp.problem.problem import Control, Problem, Representation
from mbsrun.ocp.searching.attempts import list_open_tasks, summarise
from mbsrun.ocp.searching.executor import LocalExecutor, Worker, choose_options
from mbsrun.ocp.searching.search import Job, Outcome, OutOfTimeError, Search
from mbsrun.ocp.searching.study import Study, Targets, identify
from mbsrun.ocp.searching.trials import MULTISTART, Found, Interpolation, ProtocolName, Trial, plan_round, restate
from mbsrun.ocp.solution import record as module
from mbsrun.ocp.solution.record import Attempt, Best, Record, Task, open_record
from tests.mbsrun.peer import Peer

TARGETS = Targets(0.64, (0.0, 0.02, 0.04), (0.0,), every=(2, 1))


@pytest.fixture
def study(reach: Problem, monkeypatch: pytest.MonkeyPatch) -> Study:
    """Two small steps aside on a coarse grid, with few starts: a solve takes some hundredths of a second."""
    none = {"noise": (0, 0), "waves": (0, 0), "branches": (0, 0), "turns": (0, 0)}
    monkeypatch.setattr("mbsrun.ocp.searching.trials.COUNTS", {"bumps": (2, 1), **none})
    monkeypatch.setattr("mbsrun.ocp.searching.trials.HOPS", (0, 0))
    coarse = replace(reach, intervals=5, degree=2)
    return Study(coarse, "hand", TARGETS, ((1.0, 10.0), (1.0, 0.0)), (Representation.IMPL,), (0, 3))


def carry_out(study: Study, arm: Peer, path: Path, protocol: ProtocolName, seconds: float = 1e9) -> list[Attempt]:
    """Search; return what was tried this time."""
    seen: list[Attempt] = []
    with open_record(path, identify(study, arm.manifest)) as record:
        Search(study, LocalExecutor(arm), record, lambda attempt, _: seen.append(attempt), seconds).run(protocol)
        assert seen == list(record.attempts())[-len(seen) or 10**9 :]
    return seen


def test_places_and_neighbours() -> None:
    """Every second azimuth: the place beside is two indices on."""
    targets = Targets(0.64, (0.0, 0.02, 0.04, 0.06, 0.08), (-0.01, 0.0), every=(2, 1))
    assert targets.places == ((0, 0), (0, 1), (2, 0), (2, 1), (4, 0), (4, 1))
    assert set(targets.neighbours((2, 0))) == {(0, 0), (4, 0), (2, 1)}
    assert targets.position((2, 1)) == pytest.approx((0.64 * np.cos(0.04), 0.64 * np.sin(0.04), 0.0))


def test_robust_search_leaves_no_task_open_and_goes_on(study: Study, arm: Peer, tmp_path: Path) -> None:
    """Both costs; more bumps where input rates are free. Given again, nothing is left to try."""
    seen = carry_out(study, arm, tmp_path / "record", "robust")
    assert list_open_tasks(study, seen) == []
    parts = Counter((attempt.part, attempt.task.weights) for attempt in seen)
    assert parts["bumps", (1.0, 0.0)] == 2 * 2
    assert parts["bumps", (1.0, 10.0)] == 1 * 2
    assert {part for part, _ in parts} >= {"interpolation", "neighbours"}
    assert carry_out(study, arm, tmp_path / "record", "robust") == []


def test_a_search_that_was_stopped_goes_on(study: Study, arm: Peer, tmp_path: Path) -> None:
    """After two attempts: nothing is tried twice, and the end equals an uninterrupted search's."""
    smooth = replace(study, costs=((1.0, 10.0),))
    before: list[Attempt] = []

    def stop(attempt: Attempt, _: bool) -> None:
        before.append(attempt)
        if len(before) == 2:
            raise KeyboardInterrupt

    with open_record(tmp_path / "record", identify(smooth, arm.manifest)) as record, pytest.raises(KeyboardInterrupt):
        Search(smooth, LocalExecutor(arm), record, stop).run("robust")
    after = carry_out(smooth, arm, tmp_path / "record", "robust")
    whole = carry_out(smooth, arm, tmp_path / "other", "robust")
    assert len(before) == 2
    assert [timeless(attempt) for attempt in before + after] == [timeless(attempt) for attempt in whole]


def test_a_search_hops_until_nothing_is_lower(
    study: Study, arm: Peer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the best without whole turns and from the best with; each round uses the round before."""
    monkeypatch.setattr("mbsrun.ocp.searching.trials.HOPS", (1, 1))
    counts = dict.fromkeys(("bumps", "noise", "waves", "branches"), (0, 0)) | {"turns": (1, 1)}
    monkeypatch.setattr("mbsrun.ocp.searching.trials.COUNTS", counts)
    one = replace(study, targets=replace(TARGETS, every=(3, 1)), costs=((1.0, 10.0),), turning=(0,))
    seen = carry_out(one, arm, tmp_path / "record", "robust")
    hops = [attempt for attempt in seen if attempt.part == "hops"]
    assert {attempt.round for attempt in hops} == set(range(1, max(attempt.round for attempt in seen) + 1))
    lowest = min(attempt.cost for attempt in seen if attempt.cost is not None and not attempt.turns)
    assert any(attempt.guess.startswith(f"- {lowest:.9g} ") for attempt in hops)
    assert any(not attempt.guess.startswith("-") for attempt in hops) == any(attempt.turns for attempt in seen)
    assert carry_out(one, arm, tmp_path / "record", "robust") == []


def test_a_search_ends_when_its_time_is_over(study: Study, arm: Peer, tmp_path: Path) -> None:
    with pytest.raises(OutOfTimeError):
        carry_out(study, arm, tmp_path / "record", "robust", seconds=0.0)


def test_a_study_is_named_by_what_is_asked(study: Study, arm: Peer) -> None:
    """Another generator's code for the same mechanism goes on with it; another mechanism, problem or grid does not."""
    manifest = arm.manifest.model_copy(update={"mechanism": "the mechanism of a file"})
    name = identify(study, manifest)
    assert identify(study, manifest.model_copy(update={"model_hash": "of other code", "generator": "newer"})) == name
    part = replace(study, costs=study.costs[:1], targets=replace(TARGETS, every=(1, 1)), bumped=(1,))
    assert identify(part, manifest) == name
    others = [
        identify(study, manifest.model_copy(update={"mechanism": "another mechanism"})),
        identify(replace(study, problem=replace(study.problem, intervals=6)), manifest),
        identify(replace(study, targets=replace(TARGETS, radius=0.65)), manifest),
        identify(replace(study, sensor=None), manifest),
    ]
    assert len({name, *others}) == 1 + len(others)


def test_attempts_tell_what_they_were_made_with(study: Study, arm: Peer, tmp_path: Path) -> None:
    """The generated code, and the solver with its options, beside the caller's environment."""
    one = replace(study, targets=replace(TARGETS, every=(3, 1)), costs=((1.0, 10.0),))
    with open_record(tmp_path / "record", identify(one, arm.manifest)) as record:
        Search(one, LocalExecutor(arm, {"cores": 3}), record).run("paper")
        (found,) = [json.loads(told) for _, told in record.list_all()]
    assert found["generated"] == arm.manifest.model_hash[:12]
    assert (found["cores"], found["model"]) == (3, arm.manifest.model)
    assert (found["solver"], found["linear_solver"]) == ("ipopt", "mumps")


def test_an_optimum_of_another_representation_is_held(study: Study) -> None:
    """A solve from another solution has a low barrier; the problem's own options are kept."""
    task = Task((0, 0), (1.0, 10.0), "IMPL")

    def tell(problem: Problem, *, is_held: bool, protocol: str = "robust", method: str = "mbs") -> dict[str, object]:
        trial = Trial(task, protocol, "", "", Found(task, is_held))
        chosen = choose_options(problem, trial, replace(study, method=method)).solver
        return {"method": chosen.method, **dict(chosen.options)}

    given = (("mu_init", 0.5), ("mu_strategy", "adaptive"))  # IPOPT alone has the second
    own = replace(study.problem, solver=replace(study.problem.solver, options=given))
    assert tell(own, is_held=True)["linear_solver"] == "mbs"
    assert tell(study.problem, is_held=True) == {"method": "mbs", "mu_init": 1e-6, "bound_push": 1e-8}
    assert tell(study.problem, is_held=False) == {"method": "mbs"}
    assert tell(study.problem, is_held=True, protocol=MULTISTART) == {
        "method": "mbs",
        "mu_init": 1e-6,
        "bound_push": 1e-8,
    }
    assert tell(study.problem, is_held=True, protocol=MULTISTART, method="ipopt")["mu_init"] == 1e-6
    assert "mu_init" not in tell(study.problem, is_held=False, protocol=MULTISTART, method="ipopt")
    early = replace(study.problem, solver=replace(study.problem.solver, options=(("mu_init", 0.5),)))
    assert tell(early, is_held=True) == {"method": "mbs", "mu_init": 0.5, "bound_push": 1e-8}
    assert tell(own, is_held=True)["mu_init"] == 0.5
    pivots = replace(own, solver=replace(own.solver, options=(("mumps_pivtol", 0.1),)))
    assert tell(pivots, is_held=False) == {"method": "ipopt", "linear_solver": "mumps", "mumps_pivtol": 0.1}
    best = {task: Best(1.0, 0), replace(task, representation="SEMI"): Best(1.1, 0)}
    one = replace(study, targets=replace(TARGETS, every=(3, 1)), representations=(*Representation,)[:2])
    (trial,) = plan_round(replace(one, costs=(task.weights,)), "robust", 1, best, ())
    assert (trial.part, trial.start) == ("exchange", Found(task, is_held=True))


def timeless(attempt: Attempt) -> Attempt:
    return replace(attempt, cpu_seconds=0.0, cpu_seconds_evaluating=0.0)


def test_paper_protocol_is_one_solve_of_each(study: Study, arm: Peer, tmp_path: Path) -> None:
    seen = carry_out(replace(study, costs=((1.0, 10.0),)), arm, tmp_path / "record", "paper")
    assert [attempt.task.place for attempt in seen] == list(TARGETS.places)
    assert {(attempt.part, attempt.guess) for attempt in seen} == {("paper", "zero")}


def test_what_is_out_of_reach_is_recorded_and_open(
    study: Study, arm: Peer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mbsrun.ocp.guessing.guess.STARTS", 2)
    far = replace(study, targets=Targets(1.5, (0.0,), (0.0,)), costs=((1.0, 10.0),))
    seen = carry_out(far, arm, tmp_path / "record", "robust")
    assert {attempt.status for attempt in seen} == {UNREACHABLE}
    assert len(list_open_tasks(far, seen)) == 1


def test_higher_minima_are_counted_across_representations_and_parts() -> None:
    """Two places: one solved alike; at the other the paper's attempt fails in one, and is 1 % above in another."""

    def attempt(place: int, representation: str, part: str, cost: float | None) -> Attempt:
        task = Task((place, 0), (1.0, 0.0), representation)
        protocol = "paper" if part == "paper" else "robust"
        status = "Solve_Succeeded" if cost else "Failed"
        return Attempt(task, protocol, part, "zero", 0, status, 10 * place, 2.0, 1.0, cost)

    attempts = [
        attempt(1, "IMPL", "paper", 5.0),
        attempt(2, "IMPL", "paper", 1.01),
        attempt(1, "SEMI", "paper", 5.0 + 1e-7),
        attempt(2, "SEMI", "paper", None),
        attempt(2, "SEMI", "interpolation", 1.0),
    ]
    by_part = {(s.representation, s.part): s for s in summarise(attempts)}
    assert (by_part["IMPL", "paper"].solved, by_part["IMPL", "paper"].higher) == (2, 1)
    assert (by_part["SEMI", "paper"].attempts, by_part["SEMI", "paper"].solved) == (2, 1)
    assert by_part["SEMI", "paper"].higher == 0
    assert by_part["IMPL", "paper"].iterations == (10, 15, 20)
    assert by_part["IMPL", "paper"].cpu_seconds == 4.0
    assert by_part["SEMI", "result"].solved == 1
    assert ("IMPL", "result") not in by_part


@dataclass
class Pessimist:
    """Makes attempts as they are ordered, the last first; at one place SEMI's interpolation costs a percent more."""

    worker: Worker

    def carry_out(self, orders: Iterable[Job]) -> Iterator[Outcome]:
        for order in reversed(list(orders)):
            outcome = self.worker.carry_out(order)
            attempt = outcome.attempt
            if (attempt.task.representation, attempt.task.place, attempt.part) == ("SEMI", (2, 0), "interpolation"):
                assert attempt.cost is not None
                outcome = replace(outcome, attempt=replace(attempt, cost=attempt.cost * 1.01))
            yield outcome


def test_representations_exchange_what_they_found(study: Study, arm: Peer, tmp_path: Path) -> None:
    """One finds a worse motion at one place: it is started again from the other's, and ends alike."""
    two = replace(study, costs=((1.0, 10.0),), representations=(Representation.IMPL, Representation.SEMI))
    semi = Peer.__new__(Peer)
    semi.__dict__.update(arm.__dict__)
    semi._functions = {**arm._functions, "semi_res": arm._functions["impl"]}
    with open_record(tmp_path / "record", identify(two, arm.manifest)) as record:
        Search(two, Pessimist(Worker(semi)), record).run("robust")
        attempts = list(record.attempts())
        best = record.best("robust")
    exchanged = [attempt for attempt in attempts if attempt.part == "exchange"]
    assert Task((2, 0), (1.0, 10.0), "SEMI") in [attempt.task for attempt in exchanged]
    costs = [best[Task((2, 0), (1.0, 10.0), name)].cost for name in ("IMPL", "SEMI")]
    assert costs[1] == pytest.approx(costs[0], rel=1e-7)
    assert list_open_tasks(two, attempts) == []


def test_the_order_in_which_attempts_come_in_decides_nothing(study: Study, arm: Peer, tmp_path: Path) -> None:
    """A round depends on the rounds before alone: done backwards, a search tries the same, and ends alike."""

    class Backwards(LocalExecutor):
        def carry_out(self, orders: Iterable[Job]) -> Iterator[Outcome]:
            return super().carry_out(reversed(list(orders)))

    three = replace(study, targets=replace(TARGETS, every=(1, 1)), costs=((1.0, 0.0),))
    found: list[dict[object, Attempt]] = []
    for executor in (LocalExecutor(arm), Backwards(arm)):
        with open_record(tmp_path / type(executor).__name__, identify(three, arm.manifest)) as record:
            Search(three, executor, record).run("robust")
            found.append({attempt.key: timeless(attempt) for attempt in record.attempts()})
    assert found[0] == found[1]


def test_a_record_keeps_every_bit_of_the_best(reach: Problem, tmp_path: Path) -> None:
    """Of two motions, the cheaper; costs that differ by rounding are the same. The start of a round stays."""
    first = interpolate(reach, schemes.build(Family.RADAU, 4), np.arange(6.0) / 7)
    second = replace(first, u=first.u + 1)
    task = Task((0, 0), (1.0, 0.0), "IMPL")

    def add(record: Record, guess: str, number: int, cost: float, motion: Trajectory) -> bool:
        attempt = Attempt(task, "robust", "bumps", guess, number, "Solve_Succeeded", 1, 1.0, 1.0, cost)
        return record.add(attempt, motion, "a machine")

    with open_record(tmp_path / "record", "study") as record:
        assert add(record, "0", 0, 5.0, first)
        assert not add(record, "1", 1, 5.0 * (1 - 1e-8), second)
        assert add(record, "2", 2, 4.0, second)
        assert record.find((*task.row, "robust", "bumps", "1"))
        assert not record.find((*task.row, "robust", "bumps", "3"))
        assert not record.find((*task.row, "paper", "bumps", "1"))
        assert not record.of("another").find((*task.row, "robust", "bumps", "1"))
    with open_record(tmp_path / "record", "study") as record:
        assert {told for _, told in record.list_all()} == {"a machine"}
        assert record.best("robust") == {task: Best(4.0, 2)}
        assert record.best("paper") == {}
        kept = record.best_motion(task, "robust", 2)  # before round 2
        assert kept is not None
        assert np.array_equal(kept.point_q, first.point_q)
        assert np.array_equal(kept.u, first.u)


def test_other_files_are_refused(tmp_path: Path) -> None:
    """A text, a database of something else, a record of another version, a folder."""
    (tmp_path / "text").write_text("not a database, but long enough to be looked at" * 40, "utf-8")
    for name, statement in (("other", "create table t (a)"), ("old", "create table about (format text, study text)")):
        with sqlite3.connect(tmp_path / name) as connection:
            connection.execute(statement)
    for name, message in (("text", "cannot be"), ("other", "cannot be"), ("old", "no record of this"), (".", "cannot")):
        with pytest.raises(InputError, match=message), open_record(tmp_path / name, "one"):
            pass


def test_bumps_leave_both_ends_as_they_are(reach: Problem) -> None:
    """State and acceleration at the ends; elsewhere rates are the derivatives of their coordinates."""
    scheme = schemes.build(Family.RADAU, 4)
    motion = interpolate(reach, scheme, np.zeros(6))
    bumped = bump(motion, (0, 3), np.random.default_rng(1))
    for end in (0, -1):
        assert bumped.q[end] == pytest.approx(motion.q[end], abs=1e-12)
        assert bumped.qd[end] == pytest.approx(motion.qd[end], abs=1e-12)
    assert bumped.point_qdd[-1, -1] == pytest.approx(motion.point_qdd[-1, -1], abs=1e-11)
    change = np.abs(bumped.q - motion.q).max(axis=0)
    assert (change[[0, 3]] > 0.01).all()
    assert not change[[1, 2, 4, 5]].any()
    slopes = scheme.D @ np.concatenate((bumped.q[:-1, None], bumped.point_q), axis=1) / motion.t[1]
    assert slopes == pytest.approx(bumped.point_qd, abs=1e-6)
    slopes = scheme.D @ np.concatenate((bumped.qd[:-1, None], bumped.point_qd), axis=1) / motion.t[1]
    assert slopes == pytest.approx(bumped.point_qdd, abs=1e-5)


def test_an_optimum_is_mirrored(study: Study, arm: Peer) -> None:
    """The arm turns the other way in a mirror, its pendulum swings the other way; the optimum costs the same there."""
    mirror = find_mirror(study.problem, arm, "hand")
    assert mirror == (-1, 1, 1, 1, -1, 1)
    targets = Targets(0.64, (-0.04, 0.0, 0.04), (0.0,))
    two = replace(study, targets=targets, costs=((1.0, 10.0),), mirror=mirror)
    assert [targets.opposite(place) for place in targets.places] == [(2, 0), None, (0, 0)]
    origin, task = (Task((i, 0), (1.0, 10.0), "IMPL") for i in (2, 0))
    worker = Worker(arm)
    first = worker.carry_out(
        Job(two, Trial(origin, "robust", "interpolation", "dynamic", Interpolation("dynamic")), None)
    )
    cost, motion = first.attempt.cost, first.motion
    assert cost is not None
    assert motion is not None
    image = reflect(motion, mirror, arm.manifest)
    for mesh, points in ((image.q, image.point_q), (image.qd, image.point_qd)):
        assert mesh[1:] == pytest.approx(points[:, -1], abs=1e-9), "the last point of Radau ends an interval"
    forces = [
        arm("impl", q=x.point_q[:, -1], qd=x.point_qd[:, -1], qdd=x.point_qdd[:, -1], u=x.u)["Phi"]
        for x in (motion, image)
    ]
    assert forces[1] == pytest.approx(forces[0] * mirror)
    best = {origin: Best(cost, 0), task: Best(1.01 * cost, 0)}
    (trial,) = (t for t in plan_round(two, "robust", 1, best, ()) if t.part == "mirror")
    assert trial.task == task
    assert restate(two, replace(first.attempt, task=task, part="mirror", guess=trial.guess, round=1)) == trial
    outcome = worker.carry_out(Job(two, trial, motion))
    assert outcome.attempt.cost == pytest.approx(cost, rel=1e-9)
    assert outcome.attempt.iterations <= 5
    assert outcome.motion is not None
    assert outcome.motion.q == pytest.approx(motion.q * mirror, abs=1e-6)
    same = plan_round(two, "robust", 1, {origin: Best(cost, 0), task: Best(cost * (1 + 1e-9), 0)}, ())
    assert [t for t in same if t.part == "mirror"] == []
    assert find_mirror(replace(study.problem, controls=(Control("c"),)), arm, "hand") == ()


def test_no_mirror_image_is_found_by_kernels_that_fail(
    study: Study, arm: Peer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A kernel that fails in the state that is tried, and numbers that are not finite."""

    def fail(*_: object, **__: object) -> None:
        raise KernelError("impl", Place(None, None, 1), 0)

    monkeypatch.setattr(Peer, "__call__", fail)
    assert find_mirror(study.problem, arm, "hand") == ()
    undefined = {"Phi": np.full((64, 6), np.nan), "position": np.full((64, 3, 1), np.nan)}
    monkeypatch.setattr(Peer, "__call__", lambda *_, **__: undefined)
    assert find_mirror(study.problem, arm, "hand") == ()


def test_a_record_loads_no_objects() -> None:
    """Arrays of objects would run code of whoever wrote the file."""
    file = io.BytesIO()
    np.savez_compressed(file, t=np.array([{}], dtype=object))
    with pytest.raises(ValueError, match="allow_pickle"):
        module._unpack(file.getvalue())
