"""The list of planted faults fits the source, and a fault is killed only by a test that passes without it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.mutants.__main__ import BROKEN, KILLED, Outcome, Trial
from tests.mutants.drawn import Change, draw, list_changes, list_files
from tests.mutants.faults import GOLDEN, ROOT, Fault, read_faults


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


def test_drawn_faults_change_one_token_and_can_be_planted() -> None:
    """Of every file with tests; the same seed draws the same ones, and none of them is in a comment or a string."""
    faults = draw(300, "", 5)
    assert faults == draw(300, "", 5)
    assert faults != draw(300, "", 6)
    for fault in faults:
        test_a_fault_can_be_planted(fault)
        assert fault.name.startswith(f"{fault.file}:")
        if fault.file.endswith(".py"):
            text = (ROOT / fault.file).read_text("utf-8")
            compile(text.replace(fault.find, fault.replace), fault.file, "exec")
    assert {Path(fault.file).suffix for fault in faults} == {".c", ".py"}
    assert {f for f, _ in list_files("csrc/stages/realtime")} == {"csrc/stages/realtime.c"}


def test_tokens_of_comments_strings_and_imports_stay(tmp_path: Path) -> None:
    texts = {
        "a.c": '#define A (1 < 2)\n/* a < b */ const char *s = "x + 1"; // 2 > 1\nint f(int a) { return a < 3; }\n',
        "a.py": "from a import b  # 1 < 2\nWORD = '1 + 1'\n\ndef f(a: int) -> bool:\n    return a < 3\n",
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
        found = list_changes(tmp_path / name)
        assert {(change.token, change.other) for change in found} == {("<", "<="), ("<", ">"), ("3", "0"), ("3", "30")}
        at = text.index("3")
        assert Change(at, at + 1, "3", "0", text.count("\n", 0, at) + 1) in found
