"""Files of guesses for phases: which file each phase reads, what is asked of it, and all faults at once; by hand."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from mbsgen.errors import Fault, InputError
from mbsrun.ocp.guessing import recorded_phases
from mbsrun.ocp.guessing.recorded_phases import find_phased_guess
from mbsrun.ocp.solution.phases import Guess, PartialGuess

SOLVED = "whole.solution.json"


def make(*files: str | None, times: tuple[Any, ...] = ()) -> Any:
    """Phases a, b, ..., which name files, or none."""
    given = times or ((0.0, 1.0),) * len(files)
    phases = [
        SimpleNamespace(name="abc"[k], problem=SimpleNamespace(guess=SimpleNamespace(solution=file, times=given[k])))
        for k, file in enumerate(files)
    ]
    return SimpleNamespace(phases=phases)


Find = Callable[..., Any]


@pytest.fixture
def find(monkeypatch: pytest.MonkeyPatch) -> Find:
    """Return a function that finds a guess; motions are the names of files, with phases where several share one."""

    def read_one(path: Path, problem: Any, plant: Any) -> Any:
        if "bad" in path.name:
            raise InputError([Fault(path.name, 3, "", "it is bad", "mend it")])
        return (path.as_posix(), problem.guess.solution, plant)

    def read_solved(path: Path, names: tuple[str, ...], manifests: tuple[str, ...]) -> Any:
        if "bad" in path.name:
            raise InputError([Fault(path.name, 1, "", "it is bad", "mend it")])
        motions = tuple((path.as_posix(), name, m) for name, m in zip(names, manifests, strict=True))
        return Guess(motions, (("n", 2.0),))  # type: ignore[arg-type]

    monkeypatch.setattr(recorded_phases, "find_guess", read_one)
    monkeypatch.setattr(recorded_phases, "read_phased_guess", read_solved)
    monkeypatch.setattr(recorded_phases, "is_solution", lambda path: path.name.endswith("solution.json"))
    monkeypatch.setattr(recorded_phases, "equip_phases", lambda *_: SimpleNamespace(phases="ABC"))

    def call(problem: Any, other: Path | None = None, **given: Any) -> Any:
        plants: Any = SimpleNamespace(phases=[SimpleNamespace(manifest=f"m{k}") for k in range(len(problem.phases))])
        return find_phased_guess(problem, plants, Path("dir"), other, **given)

    return call


def test_phases_read_the_files_that_they_name(find: Find) -> None:
    """Below the problem's folder; phases without one are guessed otherwise."""
    found = find(make("x.csv", "y.csv"))
    assert found == Guess((("dir/x.csv", "x.csv", "A"), ("dir/y.csv", "y.csv", "B")), ())
    found = find(make(None, "y.csv"))
    assert found == PartialGuess((("b", ("dir/y.csv", "y.csv", "B")),), ())
    assert find(make(None, None)) == PartialGuess((), ())


def test_phases_that_share_a_solution_read_it_once_with_its_unknowns(find: Find) -> None:
    found = find(make(SOLVED, "y.csv", SOLVED))
    path = f"dir/{SOLVED}"
    assert found == Guess(((path, "a", "m0"), ("dir/y.csv", "y.csv", "B"), (path, "c", "m2")), (("n", 2.0),))


def test_a_folder_has_a_table_for_each_phase(find: Find, tmp_path: Path) -> None:
    found = find(make("x.csv", None), tmp_path)
    assert [motion[0] for motion in found.trajectories] == [(tmp_path / f"{name}.csv").as_posix() for name in "ab"]


def test_another_file_is_of_all_phases(find: Find) -> None:
    """A solution, or a recording that the phases' own times divide."""
    found = find(make(None, None), Path(SOLVED))
    assert [motion[:2] for motion in found.trajectories] == [(SOLVED, "a"), (SOLVED, "b")]
    found = find(make(None, None), Path("walk.csv"))
    assert [motion[0] for motion in found.trajectories] == ["walk.csv"] * 2
    found = find(make(None, times=((None, None),)), Path("walk.csv"))
    assert [motion[0] for motion in found.trajectories] == ["walk.csv"]
    found = find(make(None, None, times=((None, None),) * 2), Path(SOLVED))
    assert len(found.trajectories) == 2
    with pytest.raises(InputError, match=r"no guess\.times divide it for b, c; give each phase"):
        find(make(None, None, None, times=((None, 1.0), (None, None), (None, None))), Path("walk.csv"))


def test_faults_of_all_files_are_found_with_the_lines_of_their_names(find: Find) -> None:
    named: list[Any] = []

    def name(phase: int | None, faults: Any) -> list[Fault]:
        named.append(phase)
        return list(faults)

    with pytest.raises(InputError) as error:
        find(make("bad.csv", "bad.solution.json", "bad2.csv"), name=name)
    assert named == [None, 0, 2]
    assert {fault.file for fault in error.value.faults} == {"bad.solution.json", "bad.csv", "bad2.csv"}
    with pytest.raises(InputError) as error:
        find(make("good.csv", "bad.csv"))
    assert [fault.file for fault in error.value.faults] == ["bad.csv"]
