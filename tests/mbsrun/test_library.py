"""Compiling: a cache addressed by content, safe for many at once; flags that keep IEEE arithmetic; clear errors."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from mbsgen.errors import InputError
from mbsrun.library import CompileError, cache_folder, compile_folder, find_compiler
from tests.sample import write_sample

FAST_MATH = ["-ffast-math", "-Ofast", "-funsafe-math-optimizations", "-ffinite-math-only", "-fassociative-math"]
UNKNOWN = ["-fplugin=evil.so", "-Wl,-rpath,/tmp", "-DMBS_REAL=float", "-I/tmp", "-o", "-include", "-xc++", "-B/tmp"]


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "mbsgen"


def test_a_folder_is_compiled_once(tmp_path: Path, own_cache: Path) -> None:
    folder = write_sample(tmp_path / "sample")
    library = compile_folder(folder)
    assert library.parent == own_cache
    before = library.stat().st_mtime_ns
    assert compile_folder(write_sample(tmp_path / "copy")) == library
    assert library.stat().st_mtime_ns == before
    assert list(own_cache.iterdir()) == [library]


def test_other_sources_and_other_flags_make_another_library(
    tmp_path: Path, own_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = write_sample(tmp_path / "sample")
    plain = compile_folder(folder)
    monkeypatch.setenv("CFLAGS", "-O0")
    assert compile_folder(folder) != plain
    monkeypatch.delenv("CFLAGS")
    source = folder / "sample_impl.c"
    source.write_text(source.read_text() + "/* changed */\n")
    assert compile_folder(folder) != plain
    assert len(list(own_cache.iterdir())) == 3


def test_another_compiler_of_the_same_name_makes_another_library(
    tmp_path: Path, own_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a compiler is, and what it may assume of the processor, shows in the macros it predefines."""
    folder, wrapper = write_sample(tmp_path / "sample"), tmp_path / "cc"
    monkeypatch.setenv("CC", str(wrapper))
    for version in (1, 2):
        wrapper.write_text(f'#!/bin/sh\nexec cc "$@" -DVERSION={version}\n')
        wrapper.chmod(0o755)
        compile_folder(folder)
    assert len(list(own_cache.iterdir())) == 2


def test_many_processes_may_compile_at_once(tmp_path: Path, own_cache: Path) -> None:
    folder = write_sample(tmp_path / "sample")
    script = "import sys, mbsrun; k = mbsrun.load(sys.argv[1]); print(k.library, k.setup(p=[2, 3])['h'])"

    def load(_: int) -> str:
        command = [sys.executable, "-c", script, str(folder)]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout

    with ThreadPoolExecutor(6) as pool:
        told = set(pool.map(load, range(6)))
    assert told == {f"{next(own_cache.iterdir())} [6. 2.]\n"}


def test_a_missing_compiler_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(CompileError, match=r"cannot run no-such-compiler.*; install a C compiler, or name one in CC"):
        compile_folder(write_sample(tmp_path / "sample"))


def test_a_failing_compiler_is_told_with_its_words(tmp_path: Path, own_cache: Path) -> None:
    folder = write_sample(tmp_path / "sample")
    (folder / "sample_impl.c").write_text("#error here it ends\n")
    with pytest.raises(CompileError, match=r"(?s)cc .*sample_impl\.c.*failed with status 1:.*here it ends"):
        compile_folder(folder)
    assert list(own_cache.iterdir()) == []


@pytest.mark.parametrize("variable", ["CFLAGS", "CC"])
@pytest.mark.parametrize("flag", [*FAST_MATH, *UNKNOWN])
def test_only_known_flags_are_accepted(flag: str, variable: str) -> None:
    """F14: fast-math drops NaN checks, reassociates, and sets the loading process to flush denormals."""
    value = flag if variable == "CFLAGS" else f"cc {flag}"
    with pytest.raises(CompileError, match=f"{flag.split('=')[0]}.* is not accepted"):
        find_compiler({**os.environ, variable: value})


def test_fast_math_behind_a_wrapper_is_found(tmp_path: Path) -> None:
    wrapper = tmp_path / "cc"
    wrapper.write_text('#!/bin/sh\nexec cc -ffast-math "$@"\n')
    wrapper.chmod(0o755)
    with pytest.raises(CompileError, match="compiles with fast-math"):
        find_compiler({**os.environ, "CC": str(wrapper)})


@pytest.mark.parametrize("flags", ["-O1 -g", "-mtune=native -Wall", "-ffp-contract=off -D_FORTIFY_SOURCE=2", ""])
def test_common_flags_are_honoured(flags: str) -> None:
    assert find_compiler({**os.environ, "CFLAGS": flags}).flags[-1:] == tuple(flags.split()[-1:] or ["-fno-math-errno"])


def test_unbalanced_quotes_are_told() -> None:
    with pytest.raises(CompileError, match="CFLAGS: No closing quotation"):
        find_compiler({**os.environ, "CFLAGS": "'-O2"})


def test_the_cache_follows_the_xdg_rules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A relative XDG_CACHE_HOME is to be ignored."""
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_folder({"XDG_CACHE_HOME": "/somewhere"}) == Path("/somewhere/mbsgen")
    assert cache_folder({"XDG_CACHE_HOME": "here"}) == cache_folder({}) == tmp_path / ".cache" / "mbsgen"


def test_a_cache_that_cannot_be_written_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    with pytest.raises(CompileError, match=r"cannot write to the cache .*; set XDG_CACHE_HOME"):
        compile_folder(write_sample(tmp_path / "sample"))


@pytest.mark.parametrize("name", ["../sample_impl.c", "-fplugin=x.c", "/etc/passwd", "a b.c", "x.so", "$(id).c", ""])
def test_a_manifest_cannot_name_other_files(name: str, tmp_path: Path) -> None:
    folder = write_sample(tmp_path / "sample")
    told = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps({**told, "sources": [name]}))
    with pytest.raises(CompileError, match="cannot be a generated file"):
        compile_folder(folder)


def test_a_missing_file_is_told(tmp_path: Path) -> None:
    folder = write_sample(tmp_path / "sample")
    (folder / "sample_impl.c").unlink()
    with pytest.raises(CompileError, match=r"sample_impl\.c: No such file or directory; generate the folder again"):
        compile_folder(folder)


def test_a_folder_without_manifest_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"manifest\.json: there is no such file"):
        compile_folder(tmp_path)
