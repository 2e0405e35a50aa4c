"""Folders are written as a whole: whenever the writer is killed, the old one or the new one is there, complete."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from mbsgen.errors import InputError
from mbsgen.output import _exchange, write_file, write_folder
from mbsgen.pipeline import Options, generate

MODEL = """\
name: swing
gravity: [0, 0, -9.81]
bodies:
  - name: arm
    joint: {type: revolute, axis: y}
    mass: 2
    com: [0, 0, -0.5]
    inertia: {xx: 0.1, yy: 0.1, zz: 0.1}
"""
MANIFEST = json.dumps({"generator": "mbsgen 1.2.3", "prefix": "arm"})
OLD = {"arm.h": "old", "arm_old.c": "old", "manifest.json": MANIFEST}
NEW = {"arm.h": "new", "arm.hpp": "new", "manifest.json": MANIFEST, "matlab/arm_f.m": "new"}

# For each step: a child writes the new folder over the old one, and kills itself before the first, second, third, ...
# of the events that Python reports to audit hooks (opening, renaming and removing files, calling C).
KILLED = """
import os, pathlib, shutil, signal, sys
from mbsgen import output
from tests.mbsgen.test_output import NEW, OLD, state

out = pathlib.Path(sys.argv[1])
if sys.argv[2] == "without exchange":
    output._exchange = lambda one, other: False
output.write_folder(OLD, out)
status, step = 1, 0
while status:
    child = os.fork()
    if not child:
        left = [None] * step
        sys.addaudithook(lambda *_: left.pop() if left else os.kill(os.getpid(), signal.SIGKILL))
        output.write_folder(NEW, out)
        os._exit(0)
    status, step = os.waitpid(child, 0)[1], step + 1
    hidden = list(out.parent.glob(f".{out.name}-*"))
    print(state(out) or "aside: " + state(hidden[0] / "old"))
    for folder in hidden:
        shutil.rmtree(folder)
    if state(out) != "old":
        output.write_folder(OLD, out)
"""


def state(folder: Path) -> str:
    """Return the state of a folder: old, new, damaged; or empty, if it does not exist."""
    files = {path.relative_to(folder).as_posix(): path.read_text() for path in folder.rglob("*") if path.is_file()}
    return {json.dumps(OLD): "old", json.dumps(NEW): "new", "{}": ""}.get(json.dumps(files, sort_keys=True), "damaged")


def read_states(out: Path, how: str) -> list[str]:
    done = subprocess.run([sys.executable, "-c", KILLED, out, how], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def is_exchanging(folder: Path) -> bool:
    """Return whether the file system can exchange folders."""
    for name in ("one", "other"):
        (folder / name).mkdir()
    return _exchange(folder / "one", folder / "other")


def test_a_kill_leaves_the_old_folder_or_the_new_one(tmp_path: Path) -> None:
    if not is_exchanging(tmp_path):
        pytest.skip("this file system cannot exchange folders")
    states = read_states(tmp_path / "out", "as it is")
    assert len(states) > 10
    assert states == sorted(states, key=["old", "new"].index)
    assert set(states) == {"old", "new"}


def test_a_kill_loses_nothing_where_folders_cannot_be_exchanged(tmp_path: Path) -> None:
    """One moment is left in which the old folder is in neither place but aside."""
    states = read_states(tmp_path / "out", "without exchange")
    assert states == sorted(states, key=["old", "aside: old", "new"].index)
    assert states.count("aside: old") == 1


def test_a_folder_is_replaced_as_a_whole(tmp_path: Path) -> None:
    out = tmp_path / "deep" / "out"
    write_folder(OLD, out)
    write_folder(NEW, out)
    write_folder(NEW, out)  # each file of a folder is known as written by mbsgen
    assert state(out) == "new"
    assert list(out.parent.iterdir()) == [out]


def test_a_link_is_followed_and_stays(tmp_path: Path) -> None:
    write_folder(OLD, tmp_path / "out")
    (tmp_path / "link").symlink_to("out")
    write_folder(NEW, tmp_path / "link")
    assert (tmp_path / "link").is_symlink()
    assert state(tmp_path / "out") == "new"


ALIEN = {
    "a folder": {"notes.txt": "mine"},
    "another manifest": {"manifest.json": json.dumps({"name": "a web application"})},
    "no object": {"manifest.json": "[1, 2]"},
    "no JSON": {"manifest.json": "mbsgen"},
    "deep JSON": {"manifest.json": "[" * 100_000},
    "another generator": {"manifest.json": json.dumps({"generator": ["mbsgen"], "prefix": "arm"})},
    "a file beside": {**OLD, "notes.txt": "mine"},
    "another model's file": {**OLD, "leg_impl.c": "mine"},
    "a folder beside": {**OLD, "build/notes.txt": "mine"},
    "a file below": {**OLD, "matlab/mine.m": "mine"},
    "a file without a name": {**OLD, ".config": "mine"},
}


@pytest.mark.parametrize("what", ALIEN)
def test_what_others_wrote_is_not_replaced(what: str, tmp_path: Path) -> None:
    for name, text in ALIEN[what].items():
        (tmp_path / "out" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "out" / name).write_text(text)
    message = r"out: it (exists, and is no folder that|holds [\w./]+, which) mbsgen (wrote|did not write); name another"
    with pytest.raises(InputError, match=message):
        write_folder(NEW, tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert all((tmp_path / "out" / name).read_text() == text for name, text in ALIEN[what].items())


def test_neither_a_file_nor_the_present_folder_is_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("mine")
    monkeypatch.chdir(tmp_path)
    for out, message in (("file", "no folder that mbsgen wrote"), (".", "the folder you are in")):
        with pytest.raises(InputError, match=message):
            write_folder(NEW, Path(out))
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_what_was_compiled_in_a_folder_is_no_hindrance(tmp_path: Path) -> None:
    for name in ("check", "arm_impl.o", "__pycache__/arm.cpython-311.pyc"):
        write_folder(OLD, tmp_path / "out")
        (tmp_path / "out" / name).parent.mkdir(exist_ok=True)
        (tmp_path / "out" / name).write_text("")
        write_folder(NEW, tmp_path / "out")
        assert state(tmp_path / "out") == "new"


@pytest.mark.parametrize("write", [lambda out: write_folder(NEW, out), lambda out: write_file(b"", out)])
def test_a_place_that_cannot_be_written_is_told(write: Callable[[Path], None], tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    with pytest.raises(
        InputError, match=r"it cannot be written: (Not a directory|File exists); give another path with -o"
    ):
        write(tmp_path / "file" / "out")


def test_whatever_a_model_is_generated_with_can_be_generated_again(tmp_path: Path) -> None:
    """All that is written counts as mbsgen's own; a refused model leaves what is there."""
    model = tmp_path / "swing.yaml"
    model.write_text(MODEL)
    for options in (Options(runtime=True, targets=("python", "matlab")), Options()):
        generate(model, tmp_path / "out", options)
    before = sorted(path.name for path in (tmp_path / "out").iterdir())
    model.write_text(MODEL.replace("mass: 2", "mass: -2"))
    for out in ("out", "other"):
        with pytest.raises(InputError, match="mass"):
            generate(model, tmp_path / out)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "swing.yaml"]
