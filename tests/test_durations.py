"""Which command runs which test: by the committed list of durations, and by measurements that renew it."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest

from tests import durations
from tests.mutants.faults import read_faults

KNOWN = {"tests/a/test_a.py::test_slow": 2.0, "tests/a/test_a.py::test_endless": 100.0}
KNOWN |= {"tests/benchmarks/test_b.py::test_slow": 1.0, "tests/benchmarks/test_b.py::test_slower": 3.0}


@pytest.mark.parametrize(
    ("nodeid", "mark"),
    [
        ("tests/a/test_a.py::test_new", "quick"),
        ("tests/a/test_a.py::test_slow[case-a::b]", "core"),
        ("tests/a/test_a.py::test_endless", "rest"),
        ("tests/test_documentation.py::test_new", "rest"),
        ("tests/benchmarks/test_b.py::test_slow", "core"),
        ("tests/benchmarks/test_b.py::test_slower", "rest"),
    ],
)
def test_a_test_is_quick_until_it_is_measured_and_documents_are_not(nodeid: str, mark: str) -> None:
    assert durations.mark(nodeid, KNOWN) == mark


def test_a_function_has_the_time_of_its_cases_and_of_what_it_shares(tmp_path: Path) -> None:
    """A shared fixture counts for each function that uses it, whichever comes first; the last time of a case counts."""
    rows = [
        {"test": "t.py::test_a[1]", "seconds": 1.0, "uses": ["t.py::made"], "fixtures": {"t.py::made": 4.0}},
        {"test": "t.py::test_a[1]", "seconds": 2.0, "uses": ["t.py::made"], "fixtures": {"t.py::made": 3.0}},
        {"test": "t.py::test_a[2]", "seconds": 0.5, "uses": ["t.py::made"], "fixtures": {}},
        {"test": "t.py::test_b", "seconds": 0.25, "uses": ["t.py::made", "t.py::other"], "fixtures": {}},
        {"test": "t.py::test_c", "seconds": 0.0625, "uses": [], "fixtures": {}},
    ]
    file = tmp_path / "measured.jsonl"
    file.write_text("".join(json.dumps(row) + "\n" for row in rows), "utf-8")
    found = durations.read_measured([file])
    assert found == {"t.py::test_a": 6.5, "t.py::test_b": 4.25, "t.py::test_c": 0.0625}
    durations.write_durations(found, tmp_path / "list.tsv")
    assert durations.read_durations(tmp_path / "list.tsv") == {"t.py::test_a": 6.5, "t.py::test_b": 4.2}


def test_files_that_take_long_are_begun_first() -> None:
    """By the tests that are chosen: the longest one of a file may be left out. Tests of a file keep their order."""
    names = ["b.py::test_slow", "b.py::test_new[1]", "c.py::test_new", "a.py::test_slow[1]", "a.py::test_slow[2]"]
    items = [cast("pytest.Item", SimpleNamespace(nodeid=name)) for name in names]
    known = {"b.py::test_slow": 2.0, "b.py::test_endless": 9.0, "a.py::test_slow": 3.0}
    found = [item.nodeid for item in durations.put_long_files_first(items, known)]
    assert found == ["a.py::test_slow[1]", "a.py::test_slow[2]", *names[:3]]


def test_times_are_measured(pytester: pytest.Pytester) -> None:
    """A test that computes for 0.2 s, with a fixture that does so once for two, is found to do so."""
    pytester.makepyfile(
        """
        import time
        import pytest

        def compute():
            end = time.process_time() + 0.2
            while time.process_time() < end:
                pass

        @pytest.fixture(scope="module")
        def made():
            compute()

        def test_first(made):
            pass

        def test_second(made):
            compute()
        """
    )
    out = pytester.path / "measured.jsonl"
    result = pytester.inline_run("-p", "no:cacheprovider", plugins=[durations.Measuring(out)])
    result.assertoutcome(passed=2)
    (first, second) = durations.read_measured([out]).values()
    assert first >= 0.2
    assert second >= 0.4


def test_a_file_without_wanted_tests_is_not_imported() -> None:
    """Importing them takes longer than all quick tests."""
    folder = durations.FILE.parent
    assert not durations.has_wanted(folder / "test_documentation.py", "quick", {})
    assert not durations.has_wanted(folder / "test_documentation.py", "not rest", {})
    assert durations.has_wanted(folder / "test_documentation.py", "rest", {})
    assert durations.has_wanted(folder / "test_documentation.py", "", {})
    assert durations.has_wanted(folder / "test_durations.py", "quick", {})
    assert not durations.has_wanted(folder / "test_durations.py", "rest", {})


def test_listed_tests_exist() -> None:
    """A name that is gone is left out by `python -m tests.durations`."""
    assert set(durations.read_durations()) <= durations.find_functions(durations.FILE.parent)


def test_planted_faults_are_looked_for_before_the_rest() -> None:
    """The tests that a fault names are not all left to `make rest`."""
    known = durations.read_durations()
    for fault in read_faults():
        paths = [test for test in fault.tests if durations.mark(test, known) != durations.REST_MARK]
        assert paths, f"{fault.name}: {fault.tests} take too long"
