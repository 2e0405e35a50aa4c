"""Slices of the searches that `make fuzz` runs at length."""

from __future__ import annotations

import copy
import random
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from mbsgen.model.model import Law
from tests.fuzz import bounds, inputs, linkages, loops, mechanisms, mjcf_files, phased, problems, robots, touching
from tests.fuzz.absolute import Absolute, Data
from tests.fuzz.kinematics import fifty_digits

COUNT = 12
SOUND = 1  # the seed of a mechanism that is accepted
DRIVEN = 2  # the seed of a mechanism with a loop and a driven joint
CONTACT = 13  # the seed of a mechanism with a loop and a contact
LINKAGES = {  # seeds
    "planar": 0,
    "tied and driven": 18,  # by an equation with a coefficient at run time
}
DRIVEN_PROBLEM = 2233  # the seed of a problem of a mechanism with a driven joint, and an unknown mass
CLOSED_PROBLEM = 3637  # of a mechanism with a loop
ROUGH = 9  # the seed of a mechanism that a tolerance changes
RECORDED = 24  # the seed of a problem with a recording
MULTIPLIERS = 60048  # of one with a loop, which multipliers close, too, and a recording
CYCLE = 125  # the seed of a problem of two phases that follow each other in a cycle
IMPACT = 130  # of one with an impact that rebounds
STANDING = 122  # the seed of a problem with a contact that stands, with friction
RELAXED = 124  # of one with a contact whose times are not given, with friction


@pytest.mark.parametrize("name", inputs.KINDS)
def test_files_are_accepted_or_refused_in_words(name: str) -> None:
    """A file that ships, changed at random, brings no traceback, no process, and no half of an output."""
    tally = inputs.search(inputs.KINDS[name], COUNT, seed=0)
    assert tally.findings == ()
    assert tally.accepted + tally.refused == COUNT


@pytest.mark.parametrize("name", sorted(set(inputs.KINDS) - {"models"}))
def test_the_search_starts_from_files_that_are_accepted(name: str, tmp_path: Path) -> None:
    """Otherwise it would try refusals alone."""
    kind = inputs.KINDS[name]
    for k, (file, content) in enumerate(kind.sources()):
        folder = tmp_path / str(k)
        folder.mkdir()
        assert inputs.attempt(kind, file, content, folder) == (True, "")


def test_files_of_mjcf_are_read_as_mujoco_reads_them() -> None:
    """Drawn from the schema; each that is read without a warning has MuJoCo's residual, limits and friction."""
    tally = mjcf_files.search(COUNT, seed=0)
    assert tally.findings == []
    assert tally.agreed > COUNT / 2


def test_the_comparison_sees_another_spring(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A reader that loses springs is found."""
    body = '<body><joint name="joint1" axis="0 1 0" stiffness="3"/><geom size="0.1" pos="1 0 0"/></body>'
    (tmp_path / "machine.xml").write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    assert mjcf_files.examine(tmp_path / "machine.xml") == ""
    monkeypatch.setattr("mbsgen.importing.mjcf.reading.make_law", lambda *_: Law())
    assert "residual" in mjcf_files.examine(tmp_path / "machine.xml")


def test_robots_are_read_as_others_read_them() -> None:
    """By Pinocchio, and by Drake where it is installed."""
    tally = robots.search(6, seed=0)
    assert tally.findings == []
    assert tally.agreed >= 4


def test_files_with_nothing_in_them_are_changed() -> None:
    for seed, content in enumerate([b"", b"{}", b"a: {}", b"[]"] * 40):
        assert isinstance(inputs.mutate(content, random.Random(seed)), bytes)


def test_the_search_sees_what_is_not_well(tmp_path: Path) -> None:
    """The search finds a traceback, a file beside the output, an output of a refused file, and a process."""
    trials = {"ValueError": _raise, "left half": _leave_half, "os.system": _begin_a_process}
    for trouble, use in trials.items():
        _, seen = inputs.attempt(inputs.Kind(tuple, use), "file", b"", tmp_path)
        assert trouble in seen


def _raise(_: Path) -> None:
    raise ValueError


def _leave_half(file: Path) -> None:
    (file.parent / "half").write_text("", encoding="utf-8")
    raise inputs.MbsError("refused")


def _begin_a_process(_: Path) -> None:
    __import__("os").system("true")


def test_mechanisms_agree_with_virtual_power() -> None:
    """All functions agree with virtual power, in a program that shares no line with the generator."""
    tally = mechanisms.search(8, seed=1)
    assert tally.findings == []
    assert tally.agreed >= 4


@pytest.mark.parametrize("numbers", [*mechanisms.NUMBERS])
def test_a_mechanism_agrees_whatever_is_done_with_its_numbers(numbers: str) -> None:
    """As the file has them; all changed at run time, with and without zeros; and approximated."""
    tolerance = 0.01 if numbers == "approximate" else 0.0
    assert mechanisms.examine(replace(mechanisms.draw(SOUND), numbers=numbers, tolerance=tolerance)) == ""


def test_scenes_that_join_functions_are_written_whole() -> None:
    """With results left out, at rest or in motion, in languages that are drawn."""
    assert mechanisms.write(mechanisms.draw(40), 40) == ""


class Weightless(Absolute):
    """The reference, wrong: with another gravity than the file's."""

    def __init__(self, model: Data, names: Mapping[str, float], *, gravity: bool = True) -> None:
        super().__init__({**model, "gravity": [0, 0, 1]}, names, gravity=gravity)


def test_a_mechanism_that_is_wrong_is_found() -> None:
    """Otherwise agreement would show nothing."""
    assert "impl by" in mechanisms.examine(mechanisms.draw(SOUND), reference=Weightless)


def test_an_approximation_that_errs_by_more_than_the_tolerance_is_found() -> None:
    """Otherwise agreement would show nothing: here an approximation is held to a tenth of its tolerance."""
    rough = replace(mechanisms.draw(ROUGH), numbers="approximate", tolerance=0.1)
    assert mechanisms.examine(rough) == ""
    assert "errs by more than" in mechanisms.examine(rough, beyond=0.1)


@pytest.mark.parametrize("seed", [9, 32, 33])
def test_closed_mechanisms_agree_with_free_bodies(seed: int) -> None:
    """Loops of several kinds, a constraint and a driven joint: a program where all bodies are free finds the same."""
    assert loops.examine(loops.draw(seed), seed) == ""


def test_contacts_on_closed_mechanisms_agree_with_free_bodies() -> None:
    """A rod and a contact whose force acts: without it, the independent program finds other multipliers."""
    mechanism = loops.draw(CONTACT)
    tree, tapes = loops.write_tapes(mechanism)
    bare = replace(mechanism, model={**mechanism.model, "contacts": []})
    with fifty_digits():
        assert loops.Comparison(mechanism, tree, tapes, CONTACT).run() == ""
        assert "exp1: lam" in loops.Comparison(bare, tree, tapes, CONTACT).run()


@pytest.mark.parametrize("seed", LINKAGES.values(), ids=LINKAGES.keys())
def test_a_linkage_moves_alike_wherever_it_is_cut(seed: int) -> None:
    """A linkage with redundant equations, or with rules of its joints, cut at two places: bodies accelerate alike."""
    assert linkages.examine(seed) == ""


def test_a_closed_mechanism_that_is_wrong_is_found() -> None:
    """Otherwise agreement would show nothing: the functions are the ones of another gravity."""
    mechanism = loops.draw(DRIVEN)
    tree, tapes = loops.write_tapes(mechanism)
    other = {**mechanism.model, "gravity": [0, 0, 1]}
    with fifty_digits():
        found = loops.Comparison(replace(mechanism, model=other), tree, tapes, DRIVEN).run()
    assert all(f"{name} by" in found for name in ("impl", "exp1: qdd", "exp1: tau", "exp2: lam", "semi_red: c"))


@pytest.mark.parametrize("seed", [DRIVEN_PROBLEM, CLOSED_PROBLEM, RECORDED, MULTIPLIERS])
def test_problems_agree_with_another_transcription(seed: int) -> None:
    """Costs, limits and derivatives."""
    assert problems.examine(*problems.draw(seed)) == ""


@pytest.mark.parametrize("seed", [CYCLE, IMPACT])
def test_problems_of_phases_agree_with_another_transcription(seed: int) -> None:
    """Two phases, one after the other or in a cycle; their links have impacts, and map coordinates."""
    assert phased.examine(phased.draw(seed), seed) == ""


def test_an_impact_that_is_wrong_is_found() -> None:
    """Otherwise agreement would show nothing: the program has another restitution."""
    drawn = phased.draw(IMPACT)
    data = copy.deepcopy(drawn.data)
    (impact,) = (link["impact"] for link in data["links"] if "impact" in link)
    impact["restitution"] += 0.1
    changed = replace(drawn, data=data)
    assert "the distance of a state over the link" in phased.examine(drawn, IMPACT, stated=phased.state(changed))


@pytest.mark.parametrize("seed", [STANDING, RELAXED])
def test_problems_with_contacts_agree_with_their_sections_written_out(seed: int) -> None:
    """A point that stands, and one that may touch: forces, cones, products, velocities."""
    assert touching.examine(touching.draw(seed)) == ""


def test_a_contact_that_is_wrong_is_found() -> None:
    """Otherwise agreement would show nothing: a stand along no axis, and no products."""
    for seed in (STANDING, RELAXED):
        drawn = touching.draw(seed)
        kept = {key: x for key, x in drawn.named.data.items() if key not in ("contacts", "relaxation")}
        free = {**kept, "wrenches": drawn.written.data["wrenches"]}
        assert "no limits" in touching.examine(replace(drawn, named=replace(drawn.named, data=free)), drawn.contact)


def test_a_problem_that_is_wrong_is_found() -> None:
    """Otherwise agreement would show nothing: the program's problem has another cost, or another start."""
    drawn, plant = problems.draw(DRIVEN_PROBLEM)
    stated, equipped = problems.state(drawn, plant)
    weight = replace(stated.cost, inputs=stated.cost.inputs + 1)
    start = (*stated.start_q[:-1], stated.start_q[-1] + 0.1)
    for changed in (replace(stated, cost=weight), replace(stated, start_q=start)):
        comparison, sections = problems.compare(drawn, plant, changed, equipped)
        assert comparison.run(sections) != ""


@pytest.mark.parametrize(("name", "precision"), [("force laws at ties", "double"), ("F05 elbow", "float")])
def test_bounds_hold_in_thousands_of_states(name: str, precision: str) -> None:
    case = next(x for x in bounds.list_cases() if x.name == name)
    tallies = list(bounds.search(replace(case, functions=("exp2",)), 3000, 0, precision))
    assert [str(x) for x in tallies if not x.is_sound] == []
    assert {x.kernel for x in tallies} >= {"exp2", "jac_exp2"}
    assert all(x.compared > 500 for x in tallies)


def test_the_search_for_violations_sees_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bounds for a unit roundoff of 2^-55 are violated in double precision."""
    case = next(x for x in bounds.list_cases() if x.name == "F05 elbow")
    monkeypatch.setitem(bounds.UNITS, "double", 2.0**-55)
    assert not all(x.is_sound for x in bounds.search(replace(case, functions=("semi",)), 500, 0))
