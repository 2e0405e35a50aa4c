"""Slices of the searches that `make fuzz` runs at length."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.fuzz import inputs, mechanisms
from tests.fuzz.absolute import Absolute

COUNT = 12
SOUND = 1  # the seed of a mechanism that is accepted


@pytest.mark.parametrize("name", inputs.KINDS)
def test_files_are_accepted_or_refused_in_words(name: str) -> None:
    """What ships is accepted; nothing that it is changed to brings a traceback, a process, or half an output."""
    tally = inputs.search(inputs.KINDS[name], COUNT, seed=0)
    assert tally.findings == ()
    assert tally.accepted + tally.refused == COUNT


@pytest.mark.parametrize("name", sorted(set(inputs.KINDS) - {"models"}))
def test_the_search_starts_from_files_that_are_accepted(name: str, tmp_path: Path) -> None:
    """Or else it would try refusals alone."""
    kind = inputs.KINDS[name]
    for k, (file, content) in enumerate(kind.sources()):
        folder = tmp_path / str(k)
        folder.mkdir()
        assert inputs.attempt(kind, file, content, folder) == (True, "")


def test_the_search_sees_what_is_not_well(tmp_path: Path) -> None:
    """A traceback, a file beside, an output of what is refused: the search would tell."""
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
    """A slice: drawn over all that a model file says, by a program that shares no line with the generator."""
    tally = mechanisms.search(8, seed=1)
    assert tally.findings == []
    assert tally.agreed >= 4


def test_a_mechanism_that_is_wrong_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Or else agreement would show nothing: the reference is given another gravity than the file."""
    drawn = mechanisms.draw(SOUND)
    assert mechanisms.examine(drawn) == ""
    model = drawn.model | {"gravity": [0, 0, 1]}
    monkeypatch.setattr(mechanisms, "Absolute", lambda _, names, **__: Absolute(model, names))
    assert "impl by" in mechanisms.examine(drawn)
