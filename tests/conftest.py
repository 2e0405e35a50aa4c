"""Fixtures of all tests: a separate cache for each run, separate random numbers for each test, and missing tools."""

from __future__ import annotations

import gc
import os
import shutil
import zlib
from collections.abc import Callable, Generator, Iterator
from functools import cache as keep
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest

from tests import durations

pytest_plugins = ("pytester",)

Report = TypeVar("Report", pytest.TestReport, pytest.CollectReport)


def pytest_sessionstart() -> None:
    """Search for cycles of objects rarely: most tests make tapes, which have none."""
    gc.set_threshold(100_000, 50, 50)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option that measures tests."""
    parser.addoption("--measure", type=Path, metavar="FILE", help="Append the processor time of each test to a file.")


def pytest_configure(config: pytest.Config) -> None:
    """Measure where that is asked for; workers of pytest-xdist have the same options."""
    if config.getoption("--measure") is not None:
        config.pluginmanager.register(durations.Measuring(config.getoption("--measure")))


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave files out that have no test of the wanted mark: importing all of them takes longer than quick tests."""
    if not (collection_path.name.startswith("test_") and collection_path.suffix == ".py"):
        return None
    return None if durations.has_wanted(collection_path, config.option.markexpr, _known()) else True


@keep
def _known() -> dict[str, float]:
    return durations.read_durations()


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> Generator[None, None, None]:
    """Mark tests by how long they take, before they are chosen by marks; begin with the files that take the longest.

    So no process is left alone with them at the end.
    """
    for item in items:
        item.add_marker(durations.mark(item.nodeid, _known()))
    yield
    items[:] = durations.put_long_files_first(items, _known())


@pytest.fixture(scope="session")
def requires() -> Callable[[str], str]:
    """Find the path of a tool by its name, or skip the test that asks for one that is missing."""

    def find(tool: str) -> str:
        path = shutil.which(tool)
        if path is None:
            pytest.skip(f"{tool} is not on the PATH")
        return path

    return find


@pytest.fixture(scope="session")
def run_folder(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> Path:
    """Return a folder of this run; under pytest-xdist all its workers have the same."""
    own = tmp_path_factory.getbasetemp()
    return own.parent if hasattr(request.config, "workerinput") else own


@pytest.fixture(scope="session", autouse=True)
def cache(run_folder: Path) -> Iterator[Path]:
    """Keep what is generated and compiled apart from the user's, for all processes of the run, with plain flags.

    Zig keeps its C libraries, which take it half a minute to compile, in the user's cache. Planted faults name one
    cache for many runs.
    """
    place = Path(os.environ.get("MBS_TESTS_CACHE") or run_folder / "cache")
    place.mkdir(parents=True, exist_ok=True)
    zig = os.environ.get("ZIG_GLOBAL_CACHE_DIR") or str(Path.home() / ".cache" / "zig")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ZIG_GLOBAL_CACHE_DIR", zig)
        patch.setenv("XDG_CACHE_HOME", str(place))
        patch.setenv("MBS_TESTS_CACHE", str(place))  # the solver's objects are kept there
        patch.delenv("CFLAGS", raising=False)
        yield place / "mbsgen"


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """Random numbers of one test, made from its name: no other test changes them."""
    return np.random.default_rng(zlib.crc32(request.node.name.encode()))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Judge the report of a test."""
    return _judge((yield))


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report() -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    """Judge the report of a module, which may skip as a whole."""
    return _judge((yield))


def _judge(report: Report) -> Report:
    """Skip for a developer, who sees the skip listed; fail where the variable CI is set."""
    if os.environ.get("CI") and report.skipped and not hasattr(report, "wasxfail"):
        report.outcome = "failed"
        report.longrepr = f"{report.longrepr}\nCI skips nothing: install in .ci/run what is missing"
    return report
