"""Which tests execute which function: measured by `python -m tests.mutants.sights`, kept in `sights.json`.

`watch` runs tests that are not long, and counts the lines that each executes: of Python by `coverage`, which has to be
installed for it, of C by gcov. A function keeps few tests: the shortest ones, until several execute each line. Lines
that no test executes are kept by their text, which stays the same where a function moves. `choose` reads the file.
"""

from __future__ import annotations

import ast
import json
import os
import re
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

import click

from tests.durations import name_function
from tests.mutants.faults import ROOT, list_files
from tests.mutants.watching import FOLDER

FILE = Path(__file__).with_suffix(".json")
LAW_FILES = "laws"
LAWS = "tests/csrc/test_laws.py::test_decisions_keep_their_laws"
SANITIZERS = "tests/csrc/test_stages.py::test_sanitizers_find_nothing"
WATCHED = (
    "tests/csrc/test_laws.py",
    "tests/csrc/test_least.py",
    "tests/csrc/test_realtime.py",
    *(f"tests/csrc/test_stages{name}.py" for name in ("", "_inner", "_team")),
    *(f"tests/mbsrun/{name}" for name in ("controllers", "identification", "linearisation", "ocp", "optimal")),
    *(f"tests/mbsrun/{name}" for name in ("recordings", "simulation", "tracking")),
    *(f"tests/mbsrun/test_{name}.py" for name in ("arm_reach", "car", "closure", "constraints", "found_numbers")),
    *(f"tests/mbsrun/test_{name}.py" for name in ("problem_files", "quickest", "results", "rollouts", "signals")),
)
TIMES = 6  # tests that execute a line, where there are as many
CASES = 2  # of one test, of a function
MOST = 24  # tests of a function
SECONDS = 60.0  # of processor, for the tests of a function
_C_BEGIN = re.compile(r"^(?!typedef|struct|enum|#)[A-Za-z_][^;=]*?\b(\w+)\([^;]*$")

Lines = Mapping[int, frozenset[int]]  # of a file: the tests that execute a line


@dataclass(frozen=True)
class Sight:
    """The tests of a function, and its lines without one."""

    tests: tuple[str, ...]  # the shortest first
    missed: frozenset[str]  # the texts of lines that no test executes


@dataclass(frozen=True)
class Measured:
    """The findings of `watch`."""

    tests: tuple[tuple[str, float], ...]  # id, seconds of processor
    lines: Mapping[str, Lines]
    possible: Mapping[str, frozenset[int]]  # the lines of a file that can be executed


def choose(file: str, line: int) -> tuple[str, ...]:
    """Return the tests that should see a change of a line, the shortest first; none where no test executes it.

    A line of no function, such as a table of numbers, has tests of all functions of its file, after the tests that are
    named after it. The laws of a C file, or of its folder, come first, and the solver's sanitizers last. A function
    that was never watched has the tests that are named after its folder.
    """
    stem = Path(file).stem.removeprefix("mbs_")
    folder = Path(file).parent.name
    stems = dict.fromkeys((stem, folder)) if file.endswith(".c") else ()
    laws = tuple(f"{LAWS}[{name}]" for each in stems for name in list_laws(each))
    last = (SANITIZERS,) if file.startswith("csrc/stages/") else ()
    text = (ROOT / file).read_text("utf-8").splitlines()[line - 1].strip()
    name = next((name for name, begin, end in list_functions(ROOT / file) if begin <= line <= end), "")
    sight = _read().get(f"{file}::{name}")
    found = sight.tests if sight and text not in sight.missed else ()
    if name and not sight:
        found = tuple(sorted(path.relative_to(ROOT).as_posix() for path in ROOT.glob(f"tests/csrc/test_{folder}.py")))
    if not name:
        found = (*sorted(path.relative_to(ROOT).as_posix() for path in ROOT.glob(f"tests/*/**/test_{stem}.py")), *found)
    return (*laws, *(test for test in found if test not in laws + last), *last)


def list_laws(stem: str) -> list[str]:
    """List the programs of laws of a C file, `NAME.c` or `NAME_PART.c`."""
    names = sorted(path.stem for path in (ROOT / "tests/csrc/laws").glob("*.c"))
    return [name for name in names if name == stem or name.startswith(f"{stem}_")]


@cache
def _read() -> Mapping[str, Sight]:
    found = Summary(**json.loads(FILE.read_text("utf-8")))
    there = {test for test in found.tests if _exists(name_function(test))}
    return {
        name: Sight(tuple(test for test in map(found.tests.__getitem__, kept) if test in there), frozenset(missed))
        for name, (kept, missed) in found.functions.items()
    }


def _exists(function: str) -> bool:
    """Return whether a test is still there, by its name."""
    file, *_, name = function.split("::")
    return f"def {name}(" in _read_text(file)


@cache
def _read_text(file: str) -> str:
    return (ROOT / file).read_text("utf-8") if (ROOT / file).exists() else ""


def list_functions(path: Path) -> list[tuple[str, int, int]]:
    """List functions and methods of a file with their first and last line; those within others belong to these."""
    text = path.read_text("utf-8")
    return list(_list_python(ast.parse(text).body, "") if path.suffix == ".py" else _list_c(text.splitlines()))


def _list_python(body: Iterable[ast.stmt], prefix: str) -> Iterator[tuple[str, int, int]]:
    for item in body:
        if isinstance(item, ast.ClassDef):
            yield from _list_python(item.body, f"{prefix}{item.name}.")
        elif isinstance(item, ast.FunctionDef | ast.AsyncFunctionDef):
            first = min([item.lineno, *(x.lineno for x in item.decorator_list)])
            yield f"{prefix}{item.name}", first, item.end_lineno or item.lineno


def _list_c(lines: Sequence[str]) -> Iterator[tuple[str, int, int]]:
    name, begin = "", 0
    for number, line in enumerate(lines, 1):
        found = _C_BEGIN.match(line)
        if found and not line.rstrip().endswith(("}", ");")):
            name, begin = found[1], number
        elif line.startswith("}") and name:
            yield name, begin, number
            name = ""
        elif line.rstrip().endswith(";") and not line.startswith((" ", "\t")):
            name = ""


def watch(folder: Path, tests: Sequence[str]) -> None:
    """Run tests, and note in a folder what each executes. Raises click.ClickException without `coverage`."""
    compiler = folder / "cc"
    watching = Path(__file__).with_name("watching.py")
    compiler.write_text(f'#!/bin/sh\nexec {sys.executable} -S -E {watching} "$@"\n', encoding="utf-8")
    compiler.chmod(0o755)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "tests.mutants.watching", *tests]
    environment = {**os.environ, FOLDER: str(folder), "CC": str(compiler)}
    if subprocess.run([sys.executable, "-c", "import coverage"], check=False).returncode:
        raise click.ClickException("which tests execute which line is counted by coverage: pip install coverage")
    subprocess.run(command, cwd=ROOT, env=environment, check=False)


def read_notes(folders: Sequence[Path]) -> Measured:
    """Read what `watch` has noted, in one or several runs."""
    tests: list[tuple[str, float]] = []
    lines: dict[str, dict[int, set[int]]] = defaultdict(lambda: defaultdict(set))
    possible: dict[str, set[int]] = defaultdict(set)
    for file in list_files():
        if file.endswith(".py"):
            possible[file] = _list_statements(ROOT / file)
    for folder in folders:
        told = [json.loads(line) for line in (folder / "tests.jsonl").read_text("utf-8").splitlines()]
        numbers = range(len(tests), len(tests) + len(told))
        _read_python_notes(folder, {entry["test"]: k for k, entry in zip(numbers, told, strict=True)}, lines, possible)
        _read_c_notes(folder, numbers, lines, possible)
        tests += [(entry["test"], entry["seconds"]) for entry in told]
    return Measured(
        tuple(tests),
        {file: {n: frozenset(each) for n, each in rows.items()} for file, rows in lines.items()},
        {file: frozenset(each) for file, each in possible.items()},
    )


def _read_python_notes(
    folder: Path, tests: Mapping[str, int], lines: Mapping[str, dict[int, set[int]]], possible: Mapping[str, set[int]]
) -> None:
    from coverage import CoverageData

    for path in sorted(folder.glob("python.db*")):
        data = CoverageData(str(path))
        data.read()
        for file in data.measured_files():
            name = Path(file).relative_to(ROOT).as_posix()
            for number, contexts in data.contexts_by_lineno(file).items():
                lines[name][number].update(tests[test] for test in contexts if test in tests)
                if not any(contexts):  # at import alone, such as the line of `def`
                    possible[name].discard(number)


def _list_statements(path: Path) -> set[int]:
    """List the lines where code begins, as coverage counts them."""
    from coverage.python import PythonParser

    parser = PythonParser(path.read_text("utf-8"))
    parser.parse_source()
    return set(parser.statements)


def _read_c_notes(
    folder: Path, numbers: range, lines: Mapping[str, dict[int, set[int]]], possible: Mapping[str, set[int]]
) -> None:
    own = {Path(file).name: file for file in list_files()}
    for place, number in enumerate(numbers):
        counts = folder / "counts" / str(place)
        for file, count, line in _run_gcov(counts, folder / "notes"):
            name = own.get(file)
            if name is not None:
                possible[name].add(line)
                if count:
                    lines[name][line].add(number)


def _run_gcov(counts: Path, notes: Path) -> Iterator[tuple[str, int, int]]:
    """Return names of files, counts and numbers of lines."""
    files = sorted(counts.rglob("*.gcda")) if counts.exists() else []
    for path in files:
        note = path.with_suffix(".gcno")
        if not note.exists():
            note.symlink_to(notes / note.relative_to(counts))
    if not files:
        return
    with tempfile.TemporaryDirectory() as place:
        done = subprocess.run(["gcov", "-t", "-j", *files], cwd=place, capture_output=True, text=True, check=False)
    for told in done.stdout.splitlines():
        for file in json.loads(told)["files"] if told.startswith("{") else ():
            path = Path(file["file"])
            if path.parent.name != LAW_FILES:  # which have the names of the files that they include
                yield from ((path.name, line["count"], line["line_number"]) for line in file["lines"])


@dataclass(frozen=True)
class Summary:
    """The content of `sights.json`."""

    tests: list[str]
    functions: dict[str, tuple[list[int], list[str]]]  # places among the tests; texts of lines that none executes


def summarise(measured: Measured) -> Summary:
    """Keep a few tests of each function, and the lines that none executes, as `choose` reads them."""
    kept: dict[str, tuple[list[int], list[str]]] = {}
    for file in sorted(measured.possible):
        rows, texts = measured.lines.get(file, {}), (ROOT / file).read_text("utf-8").splitlines()
        for name, begin, end in [*list_functions(ROOT / file), ("", 1, 0)]:
            wanted = {n for n in measured.possible[file] if (begin <= n <= end or not name)}
            own = {n: rows.get(n, frozenset()) for n in wanted}
            missed = {texts[n - 1].strip() for n, tests in own.items() if not tests} if name else set()
            missed -= {texts[n - 1].strip() for n, tests in own.items() if tests}
            kept[f"{file}::{name}"] = (_keep(own, measured.tests, Path(file).stem.removeprefix("mbs_")), sorted(missed))
    used = sorted({k for tests, _ in kept.values() for k in tests}, key=lambda k: measured.tests[k][0])
    places = {k: place for place, k in enumerate(used)}
    functions = {name: ([places[k] for k in tests], missed) for name, (tests, missed) in kept.items() if tests}
    return Summary([measured.tests[k][0] for k in used], functions)


def join(new: Summary, old: Summary) -> Summary:
    """Add what is new to what is known: tests of either, and the lines that neither executes."""
    places: dict[str, int] = {}
    functions: dict[str, tuple[list[int], list[str]]] = {}
    for name in sorted({*new.functions, *old.functions}):
        found = [(told, *told.functions[name]) for told in (new, old) if name in told.functions]
        kept = dict.fromkeys(told.tests[k] for told, tests, _ in found for k in tests)
        missed = set.intersection(*(set(texts) for _, _, texts in found))
        functions[name] = [places.setdefault(test, len(places)) for test in kept], sorted(missed)
    return Summary(list(places), functions)


def _keep(own: Lines, tests: Sequence[tuple[str, float]], stem: str) -> list[int]:
    """Choose tests that execute lines which too few others do, by names like the file's, then by length."""
    of_test: dict[int, set[int]] = defaultdict(set)
    for number, each in own.items():
        for k in each:
            of_test[k].add(number)
    chosen: list[int] = []
    seen, cases, seconds = Counter[int](), Counter[str](), 0.0
    for k in sorted(of_test, key=lambda k: (stem not in tests[k][0], tests[k][1], tests[k][0])):
        function = name_function(tests[k][0])
        fresh = [number for number in of_test[k] if seen[number] < TIMES]
        too_many = len(chosen) >= MOST or cases[function] >= CASES or seconds + tests[k][1] > SECONDS
        if fresh and (not too_many or any(not seen[number] for number in fresh)):
            chosen.append(k)
            seen.update(of_test[k])
            cases[function] += 1
            seconds += tests[k][1]
    return chosen


@click.command()
@click.option(
    "--notes",
    multiple=True,
    type=click.Path(path_type=Path, exists=True),
    help="Folders with the notes of runs, which are added to what is known.",
)
def main(notes: tuple[Path, ...]) -> None:
    """Watch the tests, or read the notes of runs, and write `sights.json`."""
    with tempfile.TemporaryDirectory() as place:
        if not notes:
            watch(Path(place), WATCHED)
        found = summarise(read_notes(notes or (Path(place),)))
    if notes:
        found = join(found, Summary(**json.loads(FILE.read_text("utf-8"))))
    text = json.dumps(asdict(found), indent=0, sort_keys=True)
    FILE.write_text(re.sub(r",\n(?=\d)|\n(?=[\d\]])|(?<=\[)\n", lambda m: m[0].strip(), text) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
