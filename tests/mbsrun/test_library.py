"""Compiling: a cache addressed by content, safe for many at once; flags that keep IEEE arithmetic; clear errors."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mbsgen import manifest as manifests
from mbsgen.errors import InputError
from mbsrun import library, load
from mbsrun.cache import ABANDONED, HASH, cache_folder, list_entries
from mbsrun.library import (
    LARGE,
    CompileError,
    choose_level,
    compile_library,
    find_compiler,
    find_zig,
    write_graphs,
)
from mbsrun.models import Extent, find_folder
from mbsrun.ocp.evaluation.stages import interface
from mbsrun.stack import read_graphs
from tests.sample import write_sample

ROOT = Path(__file__).parents[2]
FAST_MATH = ["-ffast-math", "-Ofast", "-funsafe-math-optimizations", "-ffinite-math-only", "-fassociative-math"]
UNKNOWN = ["-fplugin=evil.so", "-Wl,-rpath,/tmp", "-DMBS_REAL=float", "-I/tmp", "-o", "-include", "-xc++", "-B/tmp"]


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "mbsgen"


def compile_folder(folder: Path) -> Path:
    """Compile all of a folder to one library."""
    manifest = manifests.read(folder / manifests.FILE_NAME)
    return compile_library(folder, manifest.prefix, manifest.sources, find_compiler(os.environ))


def kept(cache: Path, suffix: str) -> list[str]:
    """List what the cache holds, by the part of the name before the hash."""
    return sorted(path.name.rpartition("-")[0] for path in cache.glob(f"compiled/*/*{suffix}"))


def all_files(cache: Path) -> list[Path]:
    """List the cache's entries, without the hashes."""
    return [path for path in cache.rglob("*") if path.is_file() and path.suffix != HASH]


def test_a_folder_is_compiled_once(tmp_path: Path, own_cache: Path) -> None:
    folder = write_sample(tmp_path / "sample")
    library = compile_folder(folder)
    before = {path: path.stat().st_ino for path in all_files(own_cache)}
    assert compile_folder(write_sample(tmp_path / "copy")) == library
    assert {path: path.stat().st_ino for path in all_files(own_cache)} == before
    assert kept(own_cache, ".so") == ["sample"]
    assert sorted(path.suffix for path in before) == [".o"] * 6 + [".so"]


def test_only_what_is_called_is_compiled(tmp_path: Path, own_cache: Path) -> None:
    """A call compiles its kernel, and `setup` if it needs that; CasADi's face the kernel with its derivatives."""
    k = load(write_sample(tmp_path / "sample"))
    assert all_files(own_cache) == []
    k.impl(x=[1, 1, 1], y=[1, 1], z=[0])
    assert kept(own_cache, ".o") == ["sample_impl", "sample_setup"]
    objects = set(own_cache.rglob("*.o"))
    k.casadi("impl")
    family = ["sample_adj1_impl", "sample_impl", "sample_jac_adj1_impl", "sample_jac_impl"]
    assert kept(own_cache, ".o") == sorted([*family, "sample_setup"])
    assert objects < set(own_cache.rglob("*.o"))
    k.impl(x=[[1, 1, 1]] * 2, y=[1, 1], z=[0])
    assert "mbs_many" in kept(own_cache, ".o")


def test_a_change_compiles_what_it_concerns(tmp_path: Path, own_cache: Path) -> None:
    """A source, itself; a header, all that includes it."""
    folder = write_sample(tmp_path / "sample")
    compile_folder(folder)
    for name, made in (("sample_impl.c", 1), ("sample.h", 6), ("mbs_abi.h", 6), ("mbs_check.h", 0)):
        before = set(own_cache.rglob("*.o"))
        with (folder / name).open("a") as file:
            file.write("/* changed */\n")
        compile_folder(folder)
        assert len(set(own_cache.rglob("*.o")) - before) == made, name


HALF = "double mbs_half(double x);\ndouble mbs_half(double x) { return x / 2; }\n"


def test_c_that_serves_every_model_is_compiled_once(tmp_path: Path, own_cache: Path) -> None:
    (tmp_path / "mbs_half.c").write_text(HALF, encoding="utf-8")
    compiler = find_compiler(os.environ)
    libraries = {compile_library(tmp_path, prefix, ["mbs_half.c"], compiler) for prefix in ("one", "two")}
    assert sorted(path.parent.name for path in libraries) == ["one", "two"]
    assert [path.parent.name for path in own_cache.rglob("*.o")] == ["mbs"]


def test_call_graphs_are_written_once(
    tmp_path: Path, own_cache: Path, requires: Callable[[str], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CC", requires("gcc"))
    (tmp_path / "mbs_half.c").write_text(HALF, encoding="utf-8")
    compiler = find_compiler(os.environ)
    (first,), (second,) = (write_graphs(tmp_path, prefix, ["mbs_half.c"], compiler) for prefix in ("one", "two"))
    assert first == second
    assert list(read_graphs([first])) == ["mbs_half"]
    assert [entry.kind for entry in list_entries(own_cache)] == ["object"]
    monkeypatch.setattr(library, "GRAPHS", "-O0")
    with pytest.raises(CompileError, match=r"writes no file \.ci"):
        write_graphs(tmp_path, "one", ["mbs_half.c"], compiler)
    (tmp_path / "mbs_half.c").write_text("int f(void) { return }", encoding="utf-8")
    with pytest.raises(CompileError, match=r"failed with status"):
        write_graphs(tmp_path, "one", ["mbs_half.c"], compiler)


def test_other_flags_make_another_library(tmp_path: Path, own_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = write_sample(tmp_path / "sample")
    plain = compile_folder(folder)
    monkeypatch.setenv("CFLAGS", "-O0")
    assert compile_folder(folder) != plain
    assert len(list(own_cache.rglob("*.so"))) == 2


def test_a_library_of_the_project_follows_the_flags(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first flags of a process do not hold for all that it solves."""
    monkeypatch.setenv("CFLAGS", "-O0")
    slow = interface.load()
    assert interface.load() is slow
    monkeypatch.delenv("CFLAGS")
    assert interface.load() is not slow


def test_another_compiler_of_the_same_name_makes_another_library(
    tmp_path: Path, own_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The version of a compiler, and the processor's features that it uses, show in the macros it predefines."""
    folder, wrapper = write_sample(tmp_path / "sample"), tmp_path / "cc"
    monkeypatch.setenv("CC", str(wrapper))
    for version in (1, 2):
        wrapper.write_text(f'#!/bin/sh\nexec cc "$@" -DVERSION={version}\n')
        wrapper.chmod(0o755)
        compile_folder(folder)
    assert len(list(own_cache.rglob("*.so"))) == 2


@pytest.mark.usefixtures("own_cache")
def test_large_sources_are_optimised_less_unless_the_user_says_otherwise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The compiler is given the level before the user's flags, of which the last counts."""
    assert choose_level(b" " * LARGE) == "-O1"
    assert choose_level(b" " * (LARGE - 1)) == "-O3"
    wrapper, log = tmp_path / "cc", tmp_path / "log"
    wrapper.write_text(f'#!/bin/sh\necho "$@" >> {log}\nexec cc "$@"\n')
    wrapper.chmod(0o755)
    monkeypatch.setenv("CC", str(wrapper))
    monkeypatch.setenv("CFLAGS", "-O2")
    compile_folder(write_sample(tmp_path / "sample"))
    told = [line.split() for line in log.read_text().splitlines() if " -c " in line]
    assert {tuple(word for word in line if word.startswith("-O")) for line in told} == {("-O3", "-O2")}


SCRIPT = "import sys, mbsrun; k = mbsrun.load(sys.argv[1]); print(k.compile('impl', 'setup'), k.setup(p=[2, 3])['h'])"


FORKED = """
import os, sys, mbsrun
is_first = all(os.fork() for _ in range(31))  # a new process gets 0, and forks no more
k = mbsrun.load(sys.argv[1])
os.write(1, f"{k.compile('impl', 'setup')} {k.setup(p=[2, 3])['h']}\\n".encode())
for _ in range(31 if is_first else 0):
    assert os.wait()[1] == 0
"""


def test_32_processes_may_compile_at_once(tmp_path: Path, own_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All get the same library, and each object is compiled by one of them."""
    wrapper, log = tmp_path / "cc", tmp_path / "log"
    wrapper.write_text(f'#!/bin/sh\necho "$@" >> {log}\nexec cc "$@"\n')
    wrapper.chmod(0o755)
    monkeypatch.setenv("CC", str(wrapper))
    folder = write_sample(tmp_path / "sample")
    done = subprocess.run([sys.executable, "-c", FORKED, str(folder)], capture_output=True, text=True, check=True)
    told = done.stdout.splitlines()
    assert (len(told), len(set(told))) == (32, 1)
    assert log.read_text().count(" -c ") == 2
    assert not list(own_cache.rglob("*.lock"))


@pytest.mark.parametrize("ending", ["-c", "-shared"])
def test_a_process_killed_in_the_middle_of_writing_leaves_nothing_that_is_met(
    ending: str, tmp_path: Path, own_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The compiler writes half a file, and the process that called it is killed; the next one is not deceived."""
    wrapper, once = tmp_path / "cc", tmp_path / "once"
    wrapper.write_text(f"""#!/bin/sh
case " $* " in *" {ending} "*)
    if [ -e {once} ]; then
        while [ "$1" != -o ]; do shift; done
        printf half > "$2"
        rm {once}
        kill -9 $PPID
        exit 1
    fi ;;
esac
exec cc "$@"
""")
    wrapper.chmod(0o755)
    once.write_text("")
    monkeypatch.setenv("CC", str(wrapper))
    command = [sys.executable, "-c", SCRIPT, str(write_sample(tmp_path / "sample"))]
    assert subprocess.run(command, capture_output=True, check=False).returncode == -signal.SIGKILL
    assert not once.exists()
    left = [path.read_bytes() for path in own_cache.glob("building-*/*") if path.suffix in (".o", ".so")]
    assert b"half" in left  # beside files that were compiled at the same time, and may be finished
    again = subprocess.run(command, capture_output=True, text=True, check=False)
    assert again.stdout.endswith("[6. 2.]\n"), again.stderr


def test_what_killed_processes_left_is_removed_after_a_day(tmp_path: Path, own_cache: Path) -> None:
    old, fresh = own_cache / "building-old", own_cache / "building-fresh"
    for place in (old, fresh):
        place.mkdir(parents=True)
        (place / "half.o").write_text("half")
    os.utime(old, (0, old.stat().st_mtime - ABANDONED - 1))
    compile_folder(write_sample(tmp_path / "sample"))
    assert [old.exists(), fresh.exists()] == [False, True]


def test_a_missing_compiler_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(CompileError, match=r"cannot run no-such-compiler.*; name another compiler in CC, or unset CC"):
        compile_folder(write_sample(tmp_path / "sample"))


def test_zig_compiles_where_the_machine_has_no_compiler(
    tmp_path: Path, own_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its kernels agree with gcc's to rounding: a mass matrix, accelerations and their derivatives."""
    pytest.importorskip("ziglang")
    folder = find_folder(ROOT / "models" / "six_axis.yaml", Extent(("semi", "exp2"), 1))
    rng = np.random.default_rng(1)
    q, qd, u = rng.uniform(-1, 1, (3, 5, 6))
    calls = {"semi": {"q": q, "qd": qd}, "exp2": {"q": q, "qd": qd, "u": u}, "jac_exp2": {"q": q, "qd": qd, "u": u}}
    expected = {name: load(folder)(name, **inputs) for name, inputs in calls.items()}
    monkeypatch.setenv("PATH", str(tmp_path))
    assert find_compiler(os.environ).command == find_zig()
    for name, results in expected.items():
        for result, values in load(folder)(name, **calls[name]).items():
            np.testing.assert_allclose(values, results[result], rtol=0, atol=1e-12 * np.abs(results[result]).max())
    assert len(kept(own_cache, ".so")) == 8  # the loop over states and three kernels, of two compilers each


def test_a_compiler_on_the_path_is_preferred_and_cc_overrides(tmp_path: Path) -> None:
    for name in ("clang", "gcc"):
        (tmp_path / name).symlink_to("/usr/bin/cc")
    environment = {**os.environ, "PATH": f"{tmp_path}"}
    assert find_compiler(environment).command == ("gcc",)
    assert find_compiler({**environment, "CC": "clang"}).command == ("clang",)
    assert find_compiler({**environment, "CC": f"{sys.executable} -m ziglang cc"}).command == find_zig()


def test_a_machine_without_any_compiler_is_helped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mbsrun.library.find_spec", lambda _: None)
    with pytest.raises(CompileError, match=r"no C compiler on the PATH; install .* pip install '\.\[compiler\]'"):
        find_compiler({"PATH": str(tmp_path)})


def test_a_failing_compiler_is_told_with_its_words(tmp_path: Path, own_cache: Path) -> None:
    folder = write_sample(tmp_path / "sample")
    (folder / "sample_impl.c").write_text("#error here it ends\n")
    with pytest.raises(CompileError, match=r"(?s)cc .*sample_impl\.c.*failed with status 1:.*here it ends"):
        compile_folder(folder)
    assert not list(own_cache.rglob("sample_impl*"))
    assert not list(own_cache.glob("building-*"))


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


def test_the_cache_follows_the_xdg_rules(tmp_path: Path) -> None:
    """A relative XDG_CACHE_HOME is to be ignored."""
    home = {"HOME": str(tmp_path)}
    assert cache_folder({"XDG_CACHE_HOME": "/somewhere"}) == Path("/somewhere/mbsgen")
    assert cache_folder({"XDG_CACHE_HOME": "here", **home}) == cache_folder(home) == tmp_path / ".cache" / "mbsgen"


@pytest.mark.parametrize("name", ["../sample_impl.c", "-fplugin=x.c", "/etc/passwd", "a b.c", "x.so", "$(id).c", ""])
def test_a_manifest_cannot_name_other_files(name: str, tmp_path: Path) -> None:
    folder = write_sample(tmp_path / "sample")
    told = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps({**told, "sources": [name]}))
    with pytest.raises(CompileError, match="cannot be a generated file"):
        compile_folder(folder)


@pytest.mark.parametrize("name", ["../sample.h", "/etc/passwd", "a b.h", "$(id).h"])
def test_a_source_cannot_include_other_files(name: str, tmp_path: Path) -> None:
    folder = write_sample(tmp_path / "sample")
    with (folder / "sample_impl.c").open("a") as file:
        file.write(f'#include "{name}"\n')
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
