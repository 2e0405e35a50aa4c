"""The prints of the program on a bare processor, as a report reads them; the tools are stand-ins."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from mbsrun import bare
from mbsrun.controllers import emulation

PERIODS = 10
TEXT = "\n".join(
    [
        "status 1", "iterations 12", "cost 0x1p-1", "solve 5000", "bytes 4096",
        *(f"input {x}" for x in range(2 * PERIODS)), *(f"step {k % 2}" for k in range(PERIODS)),
        *(f"prepare {x}" for x in (1, 2, 3, 100)), *(f"feedback {x}" for x in (7, 9, 8)),
    ]
)  # fmt: skip


@pytest.fixture
def built(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Note what is built and run; `status` is how the program ends."""
    noted: dict[str, Any] = {"status": 0}

    def compile_object(sources: list[Path], made: Path, flags: Any) -> Path:
        noted.update(sources=sources, flags=flags)
        return made

    def build(parts: list[Path], image: Path, flags: Any) -> Any:
        noted.update(main=parts[0].read_text("utf-8"), linked=flags)
        return SimpleNamespace(path=image, code=333)

    def run(_path: Path, seconds: float) -> bare.Outcome:
        noted["seconds"] = seconds
        return bare.Outcome(noted["status"], TEXT, 0, 222)

    monkeypatch.setattr(bare, "compile_object", compile_object)
    monkeypatch.setattr(bare, "find_needs", lambda _: frozenset({"sin", "cos"}))
    monkeypatch.setattr(bare, "build", build)
    monkeypatch.setattr(bare, "run", run)
    monkeypatch.setattr(emulation, "read_statuses", lambda _: ("waiting", "solved"))
    return noted


def emulate(**changes: Any) -> emulation.Emulation:
    usual = {"prefix": "push", "predicts": True, "delays": (), "sources": ("a.c", "b.c"), "inputs": ("u", "v")}
    manifest: Any = SimpleNamespace(**(usual | changes))
    return emulation.emulate(Path("place"), manifest, 4096)


def test_a_run_is_read_by_its_names(built: dict[str, Any]) -> None:
    """Inputs of ten periods; instructions by their median and their largest number."""
    found = emulate()
    assert (found.status, found.iterations, found.cost, found.solve, found.workspace) == ("solved", 12, 0.5, 5000, 4096)
    assert found.inputs == tuple((2.0 * k, 2.0 * k + 1) for k in range(PERIODS))
    assert found.steps == ("waiting", "solved") * 5
    assert (found.prepare, found.feedback) == (emulation.Count(2, 100), emulation.Count(8, 9))
    assert (found.code, found.stack, found.needs) == (333, 222, ("cos", "sin"))
    assert built["sources"] == [Path("place/a.c"), Path("place/b.c")]
    assert built["flags"] == ("-DMBS_STAGES_FLOAT",)
    assert built["linked"] == ["-DMBS_STAGES_FLOAT", "-Iplace"]
    assert 60 <= built["seconds"] <= 600


def test_the_plan_is_the_prediction_where_the_models_motion_is_not_all(built: dict[str, Any]) -> None:
    emulate()
    assert "push_predict(" in built["main"]
    for changes in ({"predicts": False}, {"delays": (1, 0)}):
        emulate(**changes)
        assert "push_predict(" not in built["main"]


def test_a_program_that_fails_is_no_result(built: dict[str, Any]) -> None:
    built["status"] = 3
    with pytest.raises(bare.BareError, match="push ended with status 3 on"):
        emulate()
