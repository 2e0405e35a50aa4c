"""Durations of tests, and the part of them that each command runs: `python -m tests.durations` renews the list.

`durations.tsv` lists the functions of tests that take more than SHORT of processor time, all their cases together, with
the fixtures that they share and with the programs that they start. From it, and from REST, each test has one of three
marks:

    quick    the others, and tests that nobody has measured yet: `make quick`
    core     up to LONG, or LONG_SELDOM: `make test`, with the quick ones
    rest     longer ones, and the kinds of REST: `make rest`; `make check` runs everything

The list is renewed from the file of `pytest --measure FILE`, for all tests or for some: `python -m tests.durations
FILE...`. Times of tests that were not measured stay. A test that comes first pays for files that others find in the
cache, so measure `pytest -m quick` once more by itself, and add its times.
"""

from __future__ import annotations

import json
import re
import resource
import sys
import time
from collections import defaultdict
from collections.abc import Generator, Iterable, Mapping
from pathlib import Path
from typing import Any

import pytest

FILE = Path(__file__).with_suffix(".tsv")
SHORT = 0.09  # s of processor
LONG = 3.0
LONG_SELDOM = 2.0  # of the kinds of SELDOM
KEY = "processor time"  # of a test's report
QUICK, CORE, REST_MARK = "quick", "core", "rest"

# Folders and files of the tests that run in `make rest` alone, by kind; the others of a kind are marked by their times.
REST: Mapping[str, tuple[str, ...]] = {
    "documents and site": ("test_documentation.py", "test_notebooks.py", "test_website.py", "test_browser.py"),
    "packages": ("test_packaging.py",),
    "golden files of many models": ("test_golden.py",),
    "random inputs": ("test_fuzz.py",),
    "every command on every kind of model": ("test_commands.py",),
}

# Kinds of which the tests that take a while run in `make rest`: few changes touch them.
SELDOM: Mapping[str, tuple[str, ...]] = {
    "benchmarks and studies": ("benchmarks/", "studies/", "mbsrun/measuring/"),
    "toolchains": (
        *("mbsgen/targets/", "csrc/test_bare", "mbsrun/test_fmu.py", "mbsrun/playground/", "mbsrun/test_library.py"),
        *("mbsgen/test_output.py", "mbsgen/test_pipeline.py", "mbsgen/test_drawing.py", "mbsrun/controllers/"),
    ),
    "other programs": ("mbsrun/peers/", "mbsgen/test_comparison.py", "mbsrun/ocp/test_moco.py"),
}


def mark(nodeid: str, durations: Mapping[str, float]) -> str:
    """Return the mark of a test."""
    function = name_function(nodeid)
    if _is_one_of(REST, function):
        return REST_MARK
    seconds, longest = durations.get(function, 0.0), LONG_SELDOM if _is_one_of(SELDOM, function) else LONG
    return QUICK if seconds <= SHORT else CORE if seconds <= longest else REST_MARK


def _is_one_of(kinds: Mapping[str, tuple[str, ...]], function: str) -> bool:
    return function.removeprefix("tests/").startswith(tuple(path for paths in kinds.values() for path in paths))


def name_function(nodeid: str) -> str:
    """Return the function of a test, without its case."""
    return nodeid.partition("[")[0]


def put_long_files_first(items: Iterable[pytest.Item], durations: Mapping[str, float]) -> list[pytest.Item]:
    """Sort tests by the time of their file, as far as they are among these; tests of a file keep their order."""
    files: dict[str, dict[str, list[pytest.Item]]] = defaultdict(lambda: defaultdict(list))
    for item in items:
        function = name_function(item.nodeid)
        files[function.partition("::")[0]][function].append(item)
    longest = sorted(files.values(), key=lambda functions: -sum(durations.get(x, 0.0) for x in functions))
    return [item for functions in longest for same in functions.values() for item in same]


def read_durations(file: Path = FILE) -> dict[str, float]:
    """Read the list: seconds by function."""
    rows = (line.split("\t") for line in file.read_text("utf-8").splitlines())
    return {name: float(seconds) for seconds, name in rows}


def write_durations(durations: Mapping[str, float], file: Path = FILE) -> None:
    """Write the functions that are not short, by name; two digits, so that little changes from run to run."""
    lines = [f"{seconds:.2g}\t{name}\n" for name, seconds in sorted(durations.items()) if seconds > SHORT]
    file.write_text("".join(lines), encoding="utf-8")


def read_measured(files: Iterable[Path]) -> dict[str, float]:
    """Add up the cases of functions in measurements, each with the fixtures that it shares with others, once."""
    own: dict[str, dict[str, float]] = defaultdict(dict)
    shared: dict[str, dict[str, float]] = defaultdict(dict)
    fixtures: dict[str, float] = {}
    for file in files:
        for line in file.read_text("utf-8").splitlines():
            found = json.loads(line)
            function = name_function(found["test"])
            own[function][found["test"]] = found["seconds"]
            shared[function].update(dict.fromkeys(found["uses"]))
            fixtures |= {name: max(x, fixtures.get(name, 0.0)) for name, x in found["fixtures"].items()}
    return {
        function: sum(cases.values()) + sum(fixtures.get(name, 0.0) for name in shared[function])
        for function, cases in own.items()
    }


def measure_processor() -> float:
    """Return the processor time of this process and of the programs that it has waited for [s]."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


class Measuring:
    """A plugin of pytest that writes the processor time of each test, and of each fixture that tests share."""

    def __init__(self, out: Path) -> None:
        """Append to a file, one line a test."""
        self.out = out
        self.fixtures: dict[str, float] = {}  # set up during the present test

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any) -> Generator[None, object, object]:
        """Take the time of a fixture."""
        start, within = measure_processor(), sum(self.fixtures.values())
        result = yield
        if fixturedef.scope != "function":
            nested = sum(self.fixtures.values()) - within
            name = _name_fixture(fixturedef)
            self.fixtures[name] = self.fixtures.get(name, 0.0) + measure_processor() - start - nested
        return result

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        """Take the time of a test."""
        self.fixtures, start = {}, measure_processor()
        result = yield
        known = getattr(item, "_fixtureinfo").name2fixturedefs  # noqa: B009  # pytest has no public name for it
        uses = [_name_fixture(x) for every in known.values() for x in every if x.scope != "function"]
        seconds = measure_processor() - start - sum(self.fixtures.values())
        told = {"test": item.nodeid, "seconds": seconds, "uses": uses, "fixtures": self.fixtures}
        with self.out.open("a", encoding="utf-8") as file:  # one short write: workers do not mix their lines
            file.write(json.dumps(told) + "\n")
        return result


def _name_fixture(fixturedef: Any) -> str:
    return f"{fixturedef.baseid}::{fixturedef.argname}"


def find_functions(folder: Path) -> set[str]:
    """List the functions of tests below a folder, as pytest names them."""
    return {name for file in folder.rglob("test_*.py") for name in _find_own(file)}


def _find_own(file: Path) -> list[str]:
    place = file.relative_to(FILE.parents[1]).as_posix()
    return [f"{place}::{name}" for name in re.findall(r"^def (test_\w+)", file.read_text("utf-8"), re.MULTILINE)]


def has_wanted(file: Path, wanted: str, durations: Mapping[str, float]) -> bool:
    """Return whether a file has tests that the option -m chooses; any other choice may choose all."""
    chosen = {"quick": {QUICK}, "core": {CORE}, "rest": {REST_MARK}, "not rest": {QUICK, CORE}}.get(wanted)
    return chosen is None or any(mark(name, durations) in chosen for name in _find_own(file))


def main(files: Iterable[str]) -> None:
    """Renew the list by measurements; functions that are gone are left out."""
    measured, known = read_measured(map(Path, files)), find_functions(FILE.parent)
    durations = {**(read_durations() if FILE.exists() else {}), **measured}
    write_durations({name: x for name, x in durations.items() if name in known})
    marks = [mark(name, measured) for name in measured]
    print(", ".join(f"{marks.count(x)} functions are {x}" for x in (QUICK, CORE, REST_MARK)))


if __name__ == "__main__":
    main(sys.argv[1:])
