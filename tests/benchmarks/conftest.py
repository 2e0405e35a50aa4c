"""What benchmarks prepare in tests is kept apart from the user's, as the libraries of `tests/mbsrun` are."""

from __future__ import annotations

from tests.mbsrun.conftest import cache, run_folder

__all__ = ["cache", "run_folder"]
