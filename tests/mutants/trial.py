"""Copies of the tree in which faults are planted, and runs of the tests that must notice them.

A fault is killed by a test that fails with it and passes without it. A drawn one counts only if it changes what is
compiled: the bytecode of a Python file, or the object of a C file, which must compile without warnings.
"""

from __future__ import annotations

import hashlib
import marshal
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

from mbsrun.library import find_compiler
from tests.durations import name_function, read_durations
from tests.mutants.faults import GOLDEN, ROOT, Fault, list_files

FOLDERS = ("benchmarks", "csrc", "docs", "generated", "generator", "models", "python", "studies", "templates", "tests")
FILES = ("pyproject.toml", "Makefile", "README.md", "ARCHITECTURE.md", "CHANGELOG.md", "LICENSE", "LICENSE-GENERATED")
STRICT = ("-Wall", "-Wextra", "-Werror")
SECONDS, TIMES = 60.0, 10.0  # of processor that a run may take, and more: a multiple of its tests' own time
WAIT = 4.0  # times that, by the clock: a fault may make a test wait for ever
KILLED, SURVIVED, BROKEN = "killed", "survived", "not run"
SAME, REFUSED = "compiles to the same", "does not compile"
NOT_FOUND = 4  # of pytest
FAILED = re.compile(r"^(?:FAILED|ERROR) (tests/.+?)(?: - .*)?$", re.MULTILINE)  # of pytest's summary
KEPT = "MBS_TESTS_CACHE"
DRAWN = frozenset(list_files())  # faults of these spoil no cache, which finds generated and compiled files by content


@dataclass(frozen=True)
class Outcome:
    """The result of the tests of a fault."""

    verdict: str
    test: str = ""  # the test that fails, or why there is none


@dataclass
class Trial:
    """A copy of the tree, the outcomes of tests in it without a fault, and the cache of its runs, if it is kept."""

    tree: Path
    kept: Path | None = None
    clean: dict[tuple[str, ...], Outcome] = field(default_factory=dict)

    def try_fault(self, fault: Fault) -> Outcome:
        """Run the tests of a fault with it, and the one that fails also without it."""
        if not fault.tests:
            return Outcome(SURVIVED, "no watched test executes it")
        original = (self.tree / fault.file).read_bytes()
        try:
            fault.apply(self.tree)
            found, killers = self._run(fault.tests, self.kept if fault.file in DRAWN else None)
        finally:
            (self.tree / fault.file).write_bytes(original)
        if found.verdict != KILLED:
            return found
        if killers not in self.clean:
            self.clean[killers] = self._run(killers, self.kept)[0]
        without = self.clean[killers]
        return found if without.verdict == SURVIVED else Outcome(BROKEN, f"without the fault: {without.test}")

    def _run(self, tests: tuple[str, ...], kept: Path | None) -> tuple[Outcome, tuple[str, ...]]:
        """Run tests until one fails; return the outcome, and the tests that show it."""
        paths = os.pathsep.join(str(self.tree / name) for name in ("generator", "python"))
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-rfE", "-p", "no:cacheprovider", f"--ignore={GOLDEN}"]
        own = {"PYTHONPATH": paths, "PYTHONDONTWRITEBYTECODE": "1", **({KEPT: str(kept)} if kept else {})}
        others = {name: x for name, x in os.environ.items() if name != KEPT}  # a fault may spoil the cache of this run
        environment = {**others, **own, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}  # no test needs a plugin
        seconds = _limit(tests)
        try:
            run = subprocess.run(
                [*command, *tests],
                cwd=self.tree,
                env=environment,
                capture_output=True,
                text=True,
                timeout=WAIT * seconds,
                check=False,
                preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds) + 5)),
            )
        except subprocess.TimeoutExpired:
            return Outcome(KILLED, f"no end after {WAIT * seconds:.0f} s"), tests
        if run.returncode == NOT_FOUND and any("[" in test for test in tests):
            return self._run(tuple(dict.fromkeys(map(name_function, tests))), kept)  # cases have other names now
        failed = tuple(FAILED.findall(run.stdout))
        if run.returncode == 1:
            return Outcome(KILLED, ", ".join(failed)), failed or tests
        if run.returncode < 0:
            return Outcome(KILLED, f"ended by signal {-run.returncode}"), tests  # such as a fault of memory, or no end
        return Outcome(SURVIVED) if run.returncode == 0 else Outcome(BROKEN, f"pytest returns {run.returncode}"), tests

    def compare(self, fault: Fault) -> str:
        """Return whether a fault compiles to the same, or not at all; an empty text for all others."""
        path = self.tree / fault.file
        original = path.read_bytes()
        try:
            before = _compile(path)
            assert before, fault.file
            fault.apply(self.tree)
            after = _compile(path)
        finally:
            path.write_bytes(original)
        return SAME if before == after else "" if after else REFUSED


def _limit(tests: tuple[str, ...]) -> float:
    """Return how much processor time a run may take [s]; files count with all their tests."""
    known = read_durations()
    names = {name_function(test) for test in tests}
    return SECONDS + TIMES * sum(s for test, s in known.items() if test in names or test.partition("::")[0] in names)


def _compile(path: Path) -> bytes:
    """Compile a file; nothing where that fails."""
    if path.suffix == ".py":
        try:
            return marshal.dumps(compile(path.read_text("utf-8"), path.name, "exec"))
        except SyntaxError:
            return b""
    compiler = find_compiler(os.environ)
    others = (ROOT / "csrc" / name for name in ("", "stages", "program", "timing"))
    folders = [f"-I{each}" for each in (path.parent, *others)]
    with tempfile.TemporaryDirectory() as place:
        made = Path(place) / "made.o"
        command = [*compiler.command, *compiler.flags, *STRICT, "-O2", *folders, "-c", path.name, "-o", str(made)]
        done = subprocess.run(command, cwd=path.parent, capture_output=True, check=False)
        return b"" if done.returncode else made.read_bytes()


def copy_tree(place: Path) -> None:
    """Copy all that tests read."""
    for name in FOLDERS:
        shutil.copytree(ROOT / name, place / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in FILES:
        shutil.copy2(ROOT / name, place / name)


def fingerprint(tree: Path) -> str:
    """Return a hash of all files of a tree."""
    digest = hashlib.sha256()
    for path in sorted(p for p in tree.rglob("*") if p.is_file()):
        digest.update(str(path.relative_to(tree)).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]
