"""The models that ship: trees, and mechanisms with closed loops."""

from __future__ import annotations

from pathlib import Path

FOLDER = Path(__file__).parents[1] / "models"
MODELS = tuple(file for file in sorted(FOLDER.glob("*.yaml")) if not file.stem.endswith(".ocp"))
CLOSED = tuple(file for file in MODELS if "\nloops:\n" in file.read_text(encoding="utf-8"))
TREES = tuple(file for file in MODELS if file not in CLOSED)
