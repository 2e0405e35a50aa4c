"""The notebooks among the documents run, and show their values; they are kept without outputs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from website import notebooks

ROOT = Path(__file__).parents[1]
FILES = sorted((ROOT / "docs").rglob("*.ipynb"))


def test_a_notebook_is_among_the_documents() -> None:
    assert ROOT / "docs" / "python.ipynb" in FILES


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_a_notebook_runs_and_shows_its_values(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A value of the project shows itself as a picture or as HTML."""
    monkeypatch.chdir(file.parent)
    values = [value for _, value in notebooks.run(file)]
    own = [value for value in values if type(value).__module__.startswith("mbsrun")]
    assert len(own) >= 5
    for value in own:
        shown = value._repr_png_() if hasattr(value, "_repr_png_") else value._repr_html_().encode()
        assert shown.startswith((b"\x89PNG", b"<div", b"<iframe"))


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_a_notebook_is_kept_without_outputs(file: Path) -> None:
    """Outputs change with every run."""
    code = [cell for cell in json.loads(file.read_text("utf-8"))["cells"] if cell["cell_type"] == "code"]
    assert [cell for cell in code if cell["outputs"] or cell["execution_count"]] == []
