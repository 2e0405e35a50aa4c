"""The cache trusts folders and files that nobody else can have written, and that match their hashes.

A test that makes another user own a file changes the system's answer about the file, so that any user can run it.
"""

from __future__ import annotations

import ctypes
import errno
import logging
import os
import shutil
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path, PurePath
from typing import Any

import numpy as np
import pytest

from mbsgen import resources
from mbsrun import binding, load, models
from mbsrun.cache import BUILDING, HASH, CacheError, cache_folder, find_or_make, list_entries
from mbsrun.library import CompileError
from mbsrun.trust import close_to_others, compute_hash
from tests.sample import write_sample

NAME = PurePath("compiled", "sample", "entry.so")
TEMPORARY = "a temporary folder replaces it"


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache that is not there yet."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "mbsgen"


@pytest.fixture
def logged(caplog: pytest.LogCaptureFixture) -> Callable[[], list[str]]:
    """Return the messages logged since the last call."""
    caplog.set_level(logging.WARNING, logger="mbsrun")

    def take() -> list[str]:
        sentences = [record.getMessage() for record in caplog.records if record.name == "mbsrun"]
        caplog.clear()
        return sentences

    return take


Logged = Callable[[], list[str]]


def write(text: str) -> Callable[[Path], Path]:
    """Make an entry that holds a text; each is made but once."""
    left = [text]

    def make(building: Path) -> Path:
        (building / "made").write_text(left.pop())
        return building / "made"

    return make


def write_folder(text: str) -> Callable[[Path], Path]:
    def make(building: Path) -> Path:
        (building / "made" / "inner").mkdir(parents=True)
        (building / "made" / "file.c").write_text(text)
        (building / "made" / "inner" / "file.h").write_text(text)
        return building / "made"

    return make


def never(_: Path) -> Path:
    raise AssertionError("it is there")


# --- who may write -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mask", [0o000, 0o002, 0o077])
def test_what_is_made_is_closed_to_others(cache: Path, mask: int) -> None:
    """Folders of the cache are for this user alone, and entries are written by nobody else, whatever the umask."""
    before = os.umask(mask)
    try:
        find_or_make(NAME, write("text"))
        find_or_make(PurePath("models", "entry"), write_folder("text"))
    finally:
        os.umask(before)
    folders = [cache.parent, cache, cache / "compiled", cache / "compiled" / "sample", cache / "models"]
    assert {stat.S_IMODE(folder.stat().st_mode) for folder in folders} == {0o700}
    assert not [path for path in cache.rglob("*") if path.stat().st_mode & 0o022]
    assert find_or_make(NAME, never).read_text() == "text"
    assert find_or_make(PurePath("models", "entry"), never).is_dir()


@pytest.fixture
def give_away(monkeypatch: pytest.MonkeyPatch) -> Callable[[Path], None]:
    """Make a path seem to belong to another user."""
    others: set[tuple[int, int]] = set()

    def change(call: Callable[..., os.stat_result]) -> Callable[..., os.stat_result]:
        def look(*arguments: Any, **options: Any) -> os.stat_result:
            found = call(*arguments, **options)
            if (found.st_dev, found.st_ino) not in others:
                return found
            return os.stat_result((*found[:4], os.geteuid() + 1, *found[5:]))

        return look

    for name in ("stat", "lstat", "fstat"):
        monkeypatch.setattr(os, name, change(getattr(os, name)))

    def give(path: Path) -> None:
        status = path.lstat()
        others.add((status.st_dev, status.st_ino))

    return give


PLACES = {"the cache": "", "its parent": "..", "a folder in it": "compiled", "the innermost": "compiled/sample"}


@pytest.mark.parametrize("place", PLACES.values(), ids=PLACES.keys())
@pytest.mark.parametrize("mode", [0o777, 0o770, 0o1777, None])
def test_a_folder_that_another_may_write_to_is_not_used(
    cache: Path, place: str, mode: int | None, give_away: Callable[[Path], None], logged: Logged
) -> None:
    """Nor is what lies there; None: it belongs to another. A sticky parent will do, a sticky cache not."""
    original = find_or_make(NAME, write("mine"))
    folder = Path(os.path.normpath(cache / place))
    if mode is None:
        give_away(folder)
    else:
        folder.chmod(mode)
    found = find_or_make(NAME, write("mine again"))
    if (place, mode) == ("..", 0o1777):
        assert (found, logged()) == (original, [])
        return
    assert cache not in found.parents
    assert found.read_text() == "mine again"
    assert stat.S_IMODE(found.parents[2].stat().st_mode) == 0o700
    assert original.read_text() == "mine", "nothing is written there"
    (sentence,) = logged()
    reason = f"{folder} belongs to another user" if mode is None else f"others may write to {folder}"
    assert f"the cache {cache} cannot be trusted: {reason}" in sentence
    assert TEMPORARY in sentence
    assert find_or_make(NAME, never) == found
    assert logged() == [], "it is said once"


def test_folders_above_the_home_folder_are_not_the_users_business(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, logged: Logged
) -> None:
    (tmp_path / "home").mkdir()
    tmp_path.chmod(0o777)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert tmp_path / "home" / ".cache" / "mbsgen" in find_or_make(NAME, write("text")).parents
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "elsewhere"))
    assert tmp_path not in find_or_make(NAME, write("text")).parents
    assert f"others may write to {tmp_path}" in logged()[0]


def test_a_link_is_followed_before_anything_is_checked(cache: Path, tmp_path: Path, logged: Logged) -> None:
    """The used folder is the link's target at the time of the check."""
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(0o777)
    (tmp_path / "open" / "real").mkdir(mode=0o700)
    cache.parent.mkdir()
    cache.symlink_to(tmp_path / "open" / "real")
    assert tmp_path not in find_or_make(NAME, write("text")).parents
    assert f"others may write to {tmp_path / 'open'}" in logged()[0]
    cache.unlink()
    (tmp_path / "closed").mkdir()
    cache.symlink_to(tmp_path / "closed")
    assert find_or_make(NAME, write("text")) == tmp_path / "closed" / NAME


@pytest.mark.parametrize("kind", ["library", "hash", "folder", "file in a folder"])
@pytest.mark.parametrize("mode", [0o666, None])
@pytest.mark.usefixtures("cache")
def test_an_entry_that_another_may_have_written_is_made_again(
    kind: str, mode: int | None, give_away: Callable[[Path], None], logged: Logged
) -> None:
    """Even if it matches its hash: that may be another's, too."""
    name = NAME if kind in ("library", "hash") else PurePath("models", "entry")
    entry = find_or_make(name, write("first") if name == NAME else write_folder("first"))
    suffixes = {"hash": entry.with_name(entry.name + HASH), "file in a folder": entry / "inner" / "file.h"}
    part = suffixes.get(kind, entry)
    if mode is None:
        give_away(part)
    else:
        part.chmod(mode | (0o111 if part.is_dir() else 0))
    assert find_or_make(name, write("second") if name == NAME else write_folder("second")) == entry
    assert (entry if name == NAME else entry / "file.c").read_text() == "second"
    assert f"{entry} has changed since it was made; it is made again" in logged()[0]


# --- what was written ----------------------------------------------------------------------------------------------


def cut(file: Path) -> None:
    os.truncate(file, file.stat().st_size // 2)


def empty(file: Path) -> None:
    os.truncate(file, 0)


def flip(file: Path) -> None:
    """Change one bit in the middle."""
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)


def replace(file: Path) -> None:
    """Put another library there, which would run when it is loaded."""
    source = file.with_name("other.c")
    source.write_text("#include <stdlib.h>\n__attribute__((constructor)) static void run(void) { _Exit(3); }\n")
    subprocess.run(["cc", "-shared", "-fPIC", str(source), "-o", str(file)], check=True)
    source.unlink()


@pytest.mark.parametrize("damage", [cut, empty, flip, replace])
@pytest.mark.parametrize("part", ["library", "hash"])
@pytest.mark.usefixtures("cache")
def test_a_library_that_does_not_match_its_hash_is_compiled_again(
    tmp_path: Path, damage: Callable[[Path], None], part: str, logged: Logged
) -> None:
    """A torn write, a bad disk, another hand: it is not loaded, and no error."""
    folder = write_sample(tmp_path / "sample")
    library = load(folder).compile("setup")
    before = library.read_bytes()
    damage(library if part == "library" else library.with_name(library.name + HASH))
    np.testing.assert_array_equal(load(folder).setup(p=[2, 3])["h"], [6, 2])
    assert library.read_bytes() == before
    assert [s for s in logged() if f"{library} has changed since it was made" in s]
    assert load(folder).compile("setup") == library
    assert logged() == []


def test_an_object_that_does_not_match_is_not_linked(tmp_path: Path, cache: Path, logged: Logged) -> None:
    folder = write_sample(tmp_path / "sample")
    load(folder).compile("setup").unlink()
    (made,) = cache.rglob("*setup*.o")
    flip(made)
    np.testing.assert_array_equal(load(folder).setup(p=[2, 3])["h"], [6, 2])
    assert f"{made} has changed since it was made" in logged()[0]


def add(folder: Path) -> None:
    (folder / "more.h").write_text("")


def rename(folder: Path) -> None:
    (folder / "inner" / "file.h").rename(folder / "inner" / "other.h")


def link(folder: Path) -> None:
    """Put a link with the same content in the place of a file."""
    content = (folder / "file.c").rename(folder.with_name("file.c"))
    (folder / "file.c").symlink_to(content)


def pipe(folder: Path) -> None:
    """A reader would wait for ever."""
    (folder / "file.c").unlink()
    os.mkfifo(folder / "file.c", mode=0o600)


FAULTS: dict[str, Callable[[Path], None]] = {
    "a file cut off": lambda folder: cut(folder / "file.c"),
    "a bit in a folder within": lambda folder: flip(folder / "inner" / "file.h"),
    "a file gone": lambda folder: (folder / "file.c").unlink(),
    "a file more": add,
    "another name": rename,
    "a link": link,
    "a pipe": pipe,
    "no folder": lambda folder: (shutil.rmtree(folder), folder.write_text("file"))[0],
}


@pytest.mark.parametrize("damage", FAULTS.values(), ids=FAULTS.keys())
@pytest.mark.usefixtures("cache")
def test_a_generated_folder_that_does_not_match_its_hash_is_made_again(
    damage: Callable[[Path], None], logged: Logged
) -> None:
    name = PurePath("models", "entry")
    folder = find_or_make(name, write_folder("text"))
    damage(folder)
    assert find_or_make(name, write_folder("text")) == folder
    assert sorted(str(p.relative_to(folder)) for p in folder.rglob("*")) == ["file.c", "inner", "inner/file.h"]
    assert not (folder / "file.c").is_symlink()
    assert logged() == [f"{folder} has changed since it was made; it is made again"]
    assert find_or_make(name, never) == folder


@pytest.mark.usefixtures("cache")
def test_what_python_writes_beside_a_module_changes_no_hash() -> None:
    name = PurePath("models", "entry")
    folder = find_or_make(name, write_folder("text"))
    (folder / "__pycache__").mkdir()
    (folder / "__pycache__" / "file.pyc").write_text("")
    assert find_or_make(name, never) == folder


def test_the_hash_tells_files_apart_by_place_and_content(tmp_path: Path) -> None:
    """Names and contents do not run into each other."""
    hashes = set()
    for i, files in enumerate(({"a": "b"}, {"a": "c"}, {"b": "a"}, {"a": "", "b": ""}, {"a/b": ""}, {"ab": ""})):
        for name, text in files.items():
            file = tmp_path / str(i) / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text)
        close_to_others(tmp_path / str(i))
        hashes.add(compute_hash(tmp_path / str(i)))
    assert len(hashes) == 6


@pytest.mark.usefixtures("cache")
def test_an_entry_of_before_there_were_hashes_is_made_anew(logged: Logged) -> None:
    """Without a word, since nothing is wrong with it."""
    entry = find_or_make(NAME, write("old"))
    entry.with_name(entry.name + HASH).unlink()
    assert find_or_make(NAME, write("new")).read_text() == "new"
    assert logged() == []


def test_a_hash_without_its_entry_is_listed_as_unfinished(cache: Path) -> None:
    """A process was killed between the two."""
    find_or_make(NAME, write("text")).unlink()
    assert [(entry.path.name, entry.kind) for entry in list_entries(cache)] == [("entry.so" + HASH, "unfinished")]


# --- places that are not as they should be -------------------------------------------------------------------------

OVERRIDE = 1 << 1  # CAP_DAC_OVERRIDE, by which root may write where nobody may


@pytest.fixture
def _plain() -> Iterator[None]:
    """Make permissions hold for root, too: drop for a while the capabilities that override them."""
    if os.geteuid():
        yield
        return
    libc = ctypes.CDLL(None, use_errno=True)
    header, numbers = (ctypes.c_uint32 * 2)(0x20080522, 0), (ctypes.c_uint32 * 6)()
    assert libc.capget(header, numbers) == 0
    numbers[0] &= ~OVERRIDE
    assert libc.capset(header, numbers) == 0
    yield
    numbers[0] |= OVERRIDE
    assert libc.capset(header, numbers) == 0


@pytest.mark.usefixtures("_plain")
def test_a_cache_that_can_only_be_read_is_read(tmp_path: Path, cache: Path, logged: Logged) -> None:
    """Missing files are compiled in a temporary folder."""
    folder = write_sample(tmp_path / "sample")
    library = load(folder).compile("setup")
    places = [cache, *(path for path in cache.rglob("*") if path.is_dir())]
    for place in places:
        place.chmod(0o500)
    try:
        assert load(folder).compile("setup") == library
        assert logged() == []
        other = load(folder).compile("impl")
        assert cache not in other.parents
        assert other.is_file()
        (sentence,) = logged()
        assert f"cannot write to the cache {cache}: Permission denied" in sentence
        assert TEMPORARY in sentence
    finally:
        for place in places:
            place.chmod(0o700)


@pytest.mark.parametrize("step", ["a source", "the compiler", "the hash"])
def test_a_full_disk_is_left_for_a_temporary_folder(
    tmp_path: Path, cache: Path, step: str, monkeypatch: pytest.MonkeyPatch, logged: Logged
) -> None:
    """Whoever notices first: Python, or a compiler, which says so in its own words."""
    wrapper = tmp_path / "cc"
    wrapper.write_text(f"""#!/bin/sh
case "$*" in *{cache}*) echo "fatal error: error writing to -: No space left on device" >&2; exit 1 ;; esac
exec cc "$@"
""")
    wrapper.chmod(0o755)
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def refuse(call: Callable[..., Any], is_meant: Callable[..., bool]) -> Callable[..., Any]:
        def act(*arguments: Any, **options: Any) -> Any:
            if is_meant(*arguments):
                raise full
            return call(*arguments, **options)

        return act

    def is_inside(path: Path, *_: object) -> bool:
        return cache in path.parents

    if step == "a source":
        monkeypatch.setattr(Path, "write_bytes", refuse(Path.write_bytes, is_inside))
    elif step == "the hash":
        monkeypatch.setattr(Path, "write_text", refuse(Path.write_text, is_inside))
    else:
        monkeypatch.setenv("CC", str(wrapper))

        def is_open_inside(descriptor: int, *_: object) -> bool:
            return cache in Path(f"/proc/self/fd/{descriptor}").readlink().parents

        monkeypatch.setattr(os, "posix_fallocate", refuse(os.posix_fallocate, is_open_inside))
    k = load(write_sample(tmp_path / "sample"))
    np.testing.assert_array_equal(k.setup(p=[2, 3])["h"], [6, 2])
    (sentence,) = logged()
    assert f"cannot write to the cache {cache}: No space left on device" in sentence
    assert not list(cache.rglob("*setup*"))
    assert not list(cache.glob(f"{BUILDING}*"))


@pytest.mark.usefixtures("cache")
def test_a_compiler_that_fails_with_room_left_is_told(tmp_path: Path, logged: Logged) -> None:
    """A fault of a source is none of the disk."""
    folder = write_sample(tmp_path / "sample")
    (folder / "sample_impl.c").write_text("#error No space left on device\n")
    with pytest.raises(CompileError, match="failed with status 1"):
        load(folder).compile("impl")
    assert logged() == []


HOMELESS = """
import pwd, sys, mbsrun
def find(number):
    raise KeyError(number)
pwd.getpwuid = find
print(mbsrun.load(sys.argv[1]).setup(p=[2, 3])["h"])
"""


@pytest.mark.parametrize("home", [None, "", "relative", "/nonexistent/home"])
def test_without_a_home_folder_nothing_is_kept(tmp_path: Path, home: str | None) -> None:
    """The user's number is not known either: one sentence, a result, and nothing is left behind."""
    environment = {key: value for key, value in os.environ.items() if key not in ("HOME", "XDG_CACHE_HOME")}
    environment |= {"TMPDIR": str(tmp_path)} | ({} if home is None else {"HOME": home})
    command = [sys.executable, "-c", HOMELESS, str(write_sample(tmp_path / "sample"))]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.stdout == "[6. 2.]\n", done.stderr
    (sentence,) = done.stderr.splitlines()
    assert sentence.startswith("there is no home folder to keep a cache in; set HOME or XDG_CACHE_HOME; a temporary")
    assert os.listdir(tmp_path) == ["sample"]
    assert not Path("/nonexistent").exists()


def test_a_temporary_folder_is_trusted_no_more_than_a_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where others may rename what lies in TMPDIR, nothing is compiled."""
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(0o777)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "open"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "open"))
    monkeypatch.setattr("mbsrun.cache._TEMPORARY", {})
    with pytest.raises(CacheError, match=rf"cannot be trusted: others may write to {tmp_path / 'open'}"):
        find_or_make(NAME, never)


@pytest.mark.parametrize("name", ["with spaces", 'it\'s "quoted"', "two\nlines", "$HOME;&|*", "-o", "ünï"])
def test_a_cache_may_have_any_path(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch, logged: Logged) -> None:
    """NumPy's face and CasADi's load libraries from there."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / name))
    k = load(write_sample(tmp_path / "sample"))
    assert cache_folder(os.environ) in k.compile("setup").parents
    np.testing.assert_array_equal(k.setup(p=[2, 3])["h"], [6, 2])
    np.testing.assert_array_equal(k.casadi("setup")([2, 3]).full().ravel(), [6, 2])
    assert logged() == []


def test_generated_folders_may_have_any_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / 'it\'s\n"my" cache'))
    folder = find_or_make(PurePath("models", "entry"), write_folder("text"))
    assert find_or_make(PurePath("models", "entry"), never) == folder


# --- what a name depends on ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Copy what generation depends on."""
    copy = tmp_path_factory.mktemp("sources")
    shutil.copytree(Path(resources.__file__).parent, copy / "mbsgen", ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("templates", "csrc"):
        shutil.copytree(resources.folder(name), copy / name)
    return copy


def test_generated_folders_depend_on_included_files(tmp_path: Path) -> None:
    """Of MJCF: a file in the folder or below it, by any spelling, and a file that it includes; no file elsewhere."""
    folder, inner = tmp_path / "robot", tmp_path / "robot" / "parts" / "arm.xml"
    inner.parent.mkdir(parents=True)
    first, deep, beside = folder / "robot.xml", folder / "hand.xml", tmp_path / "beside.xml"
    first.write_text("<mujoco><include\n file = 'parts/&#97;rm.xml'/><include file='../beside.xml'/></mujoco>")
    inner.write_text("<mujocoinclude><include file='hand.xml'/><include file='robot.xml'/></mujocoinclude>")
    for file in (deep, beside):
        file.write_text("<mujocoinclude/>")
    found = models.fingerprint(first)
    for file, matters in ((first, True), (inner, True), (deep, True), (beside, False)):
        text = file.read_text()
        file.write_text(text + "\n")
        assert (models.fingerprint(first) != found) == matters
        file.write_text(text)
    assert models.fingerprint(first) == found


def test_generated_folders_depend_on_meshes(tmp_path: Path) -> None:
    """Of MJCF, whose masses they may be: in the folder that the compiler names, or stripped of their paths."""
    model, first, other = (tmp_path / name for name in ("robot.xml", "assets/sub/a.stl", "assets/b.obj"))
    first.parent.mkdir(parents=True)
    meshes = "<mesh name='a' file='sub/a.stl'/><mesh file = 'elsewhere/b.obj'/>"
    model.write_text(f"<mujoco><compiler strippath='true' meshdir='assets'/><asset>{meshes}</asset></mujoco>")
    for file in (first, other):
        file.write_text("one")
        found = models.fingerprint(model)
        file.write_text("other")
        assert models.fingerprint(model) != found


def test_generated_folders_depend_on_tyres(tmp_path: Path) -> None:
    """A model file names them."""
    model, tyre = tmp_path / "car.yaml", tmp_path / "road.tir"
    model.write_text("contacts:\n  - {tyre: {file: road.tir, mirrored: true}}")
    tyre.write_text("one")
    found = models.fingerprint(model)
    tyre.write_text("other")
    assert models.fingerprint(model) != found


@pytest.mark.parametrize("place", ["mbsgen", "templates", "csrc"])
def test_generated_folders_depend_on_every_file_of_the_generator(
    sources: Path, place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Code, templates and hand-written C alike: a change, another name, or a file more makes another folder."""
    monkeypatch.setattr(resources, "folder", lambda name: sources / name)
    monkeypatch.setattr(resources, "__file__", str(sources / "mbsgen" / "resources.py"))
    file = tmp_path / "model.yaml"
    file.write_text("name: any\n")

    def fingerprint() -> str:
        models.fingerprint_generator.cache_clear()
        return models.fingerprint(file)

    try:
        found = [fingerprint()]
        assert fingerprint() == found[0]
        for victim in sorted(path for path in (sources / place).rglob("*.*") if path.is_file())[::7]:
            text = victim.read_bytes()
            victim.write_bytes(text + b"\n")
            found.append(fingerprint())
            victim.write_bytes(text)
            renamed = victim.rename(victim.with_name(f"x{victim.name}"))
            found.append(fingerprint())
            renamed.rename(victim)
        more = sources / place / "more.h"
        more.write_text("")
        found.append(fingerprint())
        more.unlink()
        assert fingerprint() == found[0]
        assert len(set(found)) == len(found)
    finally:
        models.fingerprint_generator.cache_clear()


def test_declarations_of_c_are_read_once(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The cache keeps structures, enumerations and functions as cffi reads them."""
    text = "typedef struct { int count; double values[3]; } mbs_part; enum mbs_kind { FIRST, LAST = 7 };"
    declare = binding.declare.__wrapped__  # without the memory of this process
    assert declare(text).sizeof("mbs_part") == 32
    monkeypatch.setattr(binding, "_read_declarations", None)
    ffi = declare(text)
    part = ffi.new("mbs_part *", {"count": 2, "values": [1.0, 2.0, 3.0]})
    assert (part.count, list(part.values)) == (2, [1.0, 2.0, 3.0])
    assert ffi.typeof("enum mbs_kind").elements == {0: "FIRST", 7: "LAST"}
    assert [entry.kind for entry in list_entries(cache)] == ["object"]
