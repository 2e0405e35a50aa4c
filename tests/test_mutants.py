"""The list of planted faults fits the source, drawn faults count where they change something, and tests kill them."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import pytest

from tests.mutants.__main__ import EQUIVALENT, choose_drawn, run
from tests.mutants.drawn import Change, draw, list_changes
from tests.mutants.faults import GOLDEN, ROOT, Fault, list_files, read_equivalent, read_faults
from tests.mutants.sights import Measured, Summary, choose, join, list_functions, summarise
from tests.mutants.trial import BROKEN, KILLED, REFUSED, SAME, SURVIVED, Outcome, Trial


@pytest.mark.parametrize("fault", read_faults(), ids=lambda fault: fault.name)
def test_a_fault_can_be_planted(fault: Fault) -> None:
    text = (ROOT / fault.file).read_text("utf-8")
    assert text.count(fault.find) == 1
    assert fault.find != fault.replace
    assert fault.tests
    for test in fault.tests:
        assert test != GOLDEN
        assert (ROOT / test.partition("::")[0]).exists()


def test_only_a_test_that_passes_without_the_fault_kills_it(tmp_path: Path) -> None:
    """The same failing test kills the fault where it passes without it, and shows nothing where it does not."""
    (tmp_path / "tests").mkdir()
    (tmp_path / "source.py").write_text("TWO = 2\n", encoding="utf-8")
    texts = {"right": "assert TWO == 2", "wrong": "assert TWO == 3"}
    for name, text in texts.items():
        code = f"from source import TWO\n\n\ndef test_{name}() -> None:\n    {text}\n"
        (tmp_path / "tests" / f"test_{name}.py").write_text(code, encoding="utf-8")
    (tmp_path / "pyproject.toml").write_text('[tool.pytest.ini_options]\npythonpath = ["."]\n', encoding="utf-8")
    trial = Trial(tmp_path)
    found = {name: trial.try_fault(Fault("three", "source.py", "2", "4", (f"tests/test_{name}.py",))) for name in texts}
    assert found == {
        "right": Outcome(KILLED, "tests/test_right.py::test_right"),
        "wrong": Outcome(BROKEN, "without the fault: tests/test_wrong.py::test_wrong"),
    }
    assert (tmp_path / "source.py").read_text("utf-8") == "TWO = 2\n"


def test_a_fault_that_no_test_executes_survives_at_once(tmp_path: Path) -> None:
    assert Trial(tmp_path).try_fault(Fault("x", "nowhere.py", "1", "2", ())).verdict == SURVIVED


def test_faults_that_compile_to_the_same_or_not_at_all_are_replaced_by_others(tmp_path: Path) -> None:
    """Bytecode for Python; objects without warnings for C, where an unused variable counts as not compiled."""
    texts = {
        "a.py": "def f(x):\n    return x < 3 + 1\n",
        "a.c": "int f(int x);\nint f(int x)\n{\n    unsigned y = (unsigned)x;\n    return y > 0 ? x * 1 : 0;\n}\n",
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    same = [Fault("", "a.py", "3 + 1", "2 + 2", ()), Fault("", "a.c", "y > 0", "y != 0", ())]
    refused = [Fault("", "a.py", "x < 3", "x <)", ()), Fault("", "a.c", "y > 0", "y >= 0", ())]
    other = [Fault("", "a.py", "x < 3", "x <= 3", ()), Fault("", "a.c", "x * 1", "x * 0", ())]
    trial = Trial(tmp_path)
    assert [trial.compare(fault) for fault in (*same, *refused, *other)] == [SAME] * 2 + [REFUSED] * 2 + [""] * 2
    chosen, left = choose_drawn([*same, *refused, *other, *other], 2, trial)
    assert set(chosen) == set(other)
    assert left == {SAME: 2, REFUSED: 2}
    assert {name: (tmp_path / name).read_text("utf-8") for name in texts} == texts


def test_equivalent_faults_are_in_words_and_are_not_tried(tmp_path: Path) -> None:
    """An entry fits the source, as a draw would give it."""
    known = read_equivalent()
    for (file, find, replace), reason in known.items():
        text = (ROOT / file).read_text("utf-8")
        assert text.count(find) == 1, (file, find)
        assert find != replace
        assert reason.endswith(".")
    faults = [Fault("", *entry, ("tests/test_none.py",)) for entry in known]
    assert run(faults, [Trial(tmp_path)]) == [Outcome(EQUIVALENT, reason) for reason in known.values()]


def test_drawn_faults_change_one_token_and_can_be_planted() -> None:
    """The same seed draws the same ones, and none of them is in a comment or a string."""
    faults = list(islice(draw("", 5), 300))
    assert faults == list(islice(draw("", 5), 300))
    assert faults != list(islice(draw("", 6), 300))
    for fault in faults:
        text = (ROOT / fault.file).read_text("utf-8")
        assert text.count(fault.find) == 1
        assert fault.find != fault.replace
        assert GOLDEN not in fault.tests
        assert fault.name.startswith(f"{fault.file}:")
        if fault.file.endswith(".py"):
            compile(text.replace(fault.find, fault.replace), fault.file, "exec")
    assert {Path(fault.file).suffix for fault in faults} == {".c", ".py"}
    assert list_files("csrc/stages/realtime") == ["csrc/stages/realtime.c"]


def test_most_functions_that_faults_are_drawn_in_have_tests_that_exist() -> None:
    """Where fewer do, `python -m tests.mutants.sights` measures anew which tests execute what."""
    faults = list(islice(draw("", 7), 300))
    assert sum(bool(fault.tests) for fault in faults) >= 0.9 * len(faults)
    assert choose("csrc/stages/search.c", 1)
    assert choose("python/mbsrun/simulation/integration/tableaus.py", 1)[0].endswith("/test_tableaus.py")


def test_functions_are_found_with_their_lines(tmp_path: Path) -> None:
    texts = {
        "a.c": "typedef int (*g)(int);\nstatic int f(int a,\n             int b)\n{\n    return a;\n}\nint h(int a);\n",
        "a.py": "X = 1\n\nclass A:\n    @b\n    def f(self):\n        def g():\n            pass\n        return g\n",
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    assert list_functions(tmp_path / "a.c") == [("f", 2, 6)]
    assert list_functions(tmp_path / "a.py") == [("A.f", 4, 8)]


def test_a_function_keeps_tests_named_after_its_file_and_then_the_shortest() -> None:
    """Few of them, and the texts of lines that no test executes."""
    file = "csrc/stages/filter.c"
    (_, begin, end), *_ = list_functions(ROOT / file)
    tests = [*((f"tests/a.py::test_{k}", 0.1 * k) for k in range(1, 30)), ("tests/b.py::test_it[filter]", 9.0)]
    possible = frozenset(range(begin, end + 1))
    seen = {n: frozenset(range(30)) for n in possible - {end}}
    found = summarise(Measured(tuple(tests), {file: seen}, {file: possible}))
    name = f"{file}::{list_functions(ROOT / file)[0][0]}"
    kept = [found.tests[k] for k in found.functions[name][0]]
    assert kept == [tests[-1][0], *(name for name, _ in tests[: len(kept) - 1])]
    assert len(kept) < 10
    assert found.functions[name][1] == ["}"]


def test_what_further_tests_execute_is_added_to_what_is_known() -> None:
    """A line is missed where neither missed it."""
    known = Summary(["a", "b"], {"f": ([0, 1], ["x", "y"]), "g": ([1], ["z"])})
    further = Summary(["c", "b"], {"f": ([0, 1], ["y", "z"]), "h": ([0], [])})
    found = join(further, known)
    tests = {name: ([found.tests[k] for k in kept], missed) for name, (kept, missed) in found.functions.items()}
    assert tests == {"f": (["c", "b", "a"], ["y"]), "g": (["b"], ["z"]), "h": (["c"], [])}


def test_tokens_of_comments_strings_and_imports_stay(tmp_path: Path) -> None:
    texts = {
        "a.c": '#define A (1 < 2)\n/* a < b */ const char *s = "x + 1"; // 2 > 1\nint f(int a) { return a < 3; }\n',
        "a.py": "from a import b  # 1 < 2\nX = F('1 + 1', examples=[[-1, 2]])\n"
        "def f(*a):\n    return [b < 3 for *_, b in a]\n",
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
        found = list_changes(tmp_path / name)
        assert {(change.token, change.other) for change in found} == {("<", "<="), ("<", ">"), ("3", "0"), ("3", "30")}
        at = text.index("3")
        assert Change(at, at + 1, "3", "0", text.count("\n", 0, at) + 1) in found


def test_a_size_that_is_left_to_numpy_becomes_no_other_negative_one(tmp_path: Path) -> None:
    """It means the same; 0 and other numbers do not."""
    file = tmp_path / "a.py"
    file.write_text("x = a.reshape(len(a), -1)[-1].reshape(-1, f(-1), n - 1)\n", encoding="utf-8")
    found = [(change.start, change.other) for change in list_changes(file) if change.token == "1"]
    places = [k for k, letter in enumerate(file.read_text("utf-8")) if letter == "1"]
    assert found == [
        (place, other) for k, place in enumerate(places) for other in ("0", "10") if other == "0" or k not in (0, 2)
    ]
