"""Folders of several models in one program: each computes with its own numbers, or the program is not built."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner

from mbsgen.cli import cli
from mbsgen.manifest import FILE_NAME, read
from mbsgen.request import OptionError
from mbsgen.targets.c.symbols import check_prefix, describe_mangling
from tests.mbsgen.targets.pendulums import (
    CASADI,
    CC,
    HEAVY,
    LIGHT,
    MODEL,
    TYPED,
    WANTED,
    compile_folder,
    list_sources,
    write,
    write_unit,
)
from tests.mbsgen.targets.programs import read_numbers, run

MAIN = """\
#include <stdio.h>
double light(void), heavy(void);
int main(void) { printf("%.17g %.17g\\n", light(), heavy()); return 0; }
"""
Build = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two folders of one name, and one of the second model with another prefix."""
    place = tmp_path_factory.mktemp("together")
    write(place, "a", LIGHT)
    write(place, "b", HEAVY)
    write(place, "c", HEAVY, prefix="heavy_arm")
    (place / "main.c").write_text(MAIN)
    return place


@pytest.mark.parametrize("call", [TYPED, CASADI])
def test_all_files_of_two_folders_make_one_program(place: Path, tmp_path: Path, call: str) -> None:
    """`cc a/*.c c/*.c` builds a program with its own main, though both folders have check programs and mbs_check.c."""
    units = [write_unit(place, "a", "light", call), write_unit(place, "c", "heavy", call, "heavy_arm")]
    sources = [*list_sources(place / "a"), *list_sources(place / "c"), place / "main.c"]
    program = tmp_path / "program"
    done = run(*CC, f"-I{place}", *units, *sources, "-lm", "-o", program, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert read_numbers(program) == pytest.approx([LIGHT * WANTED, HEAVY * WANTED], rel=1e-14)


@pytest.mark.parametrize("call", [TYPED, CASADI])
def test_static_libraries_of_one_name_are_never_mixed(place: Path, tmp_path: Path, call: str) -> None:
    """A linker takes the first definition in libraries; with the tag it needs both, and says that they clash."""
    units = [write_unit(place, "a", "light", call), write_unit(place, "b", "heavy", call)]
    libraries = []
    for name in "ab":
        objects = compile_folder(place / name, tmp_path / name)
        libraries.append(tmp_path / f"lib{name}.a")
        assert run("ar", "rc", libraries[-1], *objects, cwd=tmp_path).returncode == 0
    program = tmp_path / "program"
    done = run(*CC, f"-I{place}", place / "main.c", *units, *libraries, "-lm", "-o", program, cwd=tmp_path)
    assert done.returncode != 0
    assert "multiple definition" in done.stderr or "duplicate symbol" in done.stderr
    assert "arm_" in done.stderr


def test_objects_of_one_name_clash(place: Path, tmp_path: Path) -> None:
    """All files of two folders of one name do not link, whatever a program calls."""
    units = [write_unit(place, "a", "light"), write_unit(place, "a", "heavy")]
    sources = [*list_sources(place / "a"), *list_sources(place / "b"), place / "main.c"]
    done = run(*CC, f"-I{place}", *units, *sources, "-lm", "-o", tmp_path / "program", cwd=tmp_path)
    assert done.returncode != 0
    assert "multiple definition" in done.stderr or "duplicate symbol" in done.stderr


@pytest.mark.parametrize("call", [TYPED, CASADI])
def test_shared_libraries_of_one_name_keep_their_numbers(place: Path, tmp_path: Path, call: str) -> None:
    """The dynamic linker takes the first definition of a symbol in all libraries: each caller gets its own folder's."""
    units = [write_unit(place, "a", "light", call), write_unit(place, "b", "heavy", call)]
    libraries = []
    for name in "ab":
        objects = compile_folder(place / name, tmp_path / name, "-fPIC")
        libraries.append(tmp_path / f"lib{name}.so")
        assert run("cc", "-shared", *objects, "-lm", "-o", libraries[-1], cwd=tmp_path).returncode == 0
    program = tmp_path / "program"
    command = (*CC, f"-I{place}", place / "main.c", *units, *libraries, "-lm", "-o", program)
    done = run(*command, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert read_numbers(program) == pytest.approx([LIGHT * WANTED, HEAVY * WANTED], rel=1e-14)


@pytest.mark.parametrize("suffix", ["h", "hpp"])
def test_headers_of_one_name_and_other_content_stop_the_compiler(place: Path, tmp_path: Path, suffix: str) -> None:
    """The guard of the first header would hide the second one."""
    unit = tmp_path / ("unit.c" if suffix == "h" else "unit.cpp")
    compiler = CC[:1] if suffix == "h" else ("c++", "-std=c++17")
    unit.write_text(f'#include "a/arm.{suffix}"\n#include "b/arm.{suffix}"\n')
    done = run(*compiler, f"-I{place}", "-c", unit, "-o", tmp_path / "unit.o", cwd=tmp_path)
    assert done.returncode != 0
    assert "two models are called arm: generate one of them with --prefix NAME" in done.stderr
    unit.write_text(f'#include "a/arm.{suffix}"\n#include "a/arm.{suffix}"\n#include "c/heavy_arm.{suffix}"\n')
    assert run(*compiler, f"-I{place}", "-c", unit, "-o", tmp_path / "unit.o", cwd=tmp_path).returncode == 0


def test_inline_functions_of_cpp_are_their_folders_own(place: Path, tmp_path: Path) -> None:
    """Inline functions of one name in two files are one function in C++, with either body."""
    unit = """\
#include "{folder}/arm.hpp"
#include <vector>
extern "C" double {function}() {{
    arm_model m;
    const std::vector<double> q{{0.5}}, rest{{0}};
    return m.impl(q, rest, rest, rest)[0];
}}
"""
    objects = []
    for folder, function in (("a", "light"), ("b", "heavy")):
        source = tmp_path / f"{function}.cpp"
        source.write_text(unit.format(folder=folder, function=function))
        objects.append(tmp_path / f"{function}.o")
        done = run("c++", "-std=c++17", "-O0", f"-I{place}", "-c", source, "-o", objects[-1], cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        compiled = compile_folder(place / folder, tmp_path / folder, "-fPIC")
        objects.append(tmp_path / f"lib{folder}.so")
        assert run("cc", "-shared", *compiled, "-lm", "-o", objects[-1], cwd=tmp_path).returncode == 0
    main = tmp_path / "main.o"
    assert run("cc", "-c", place / "main.c", "-o", main, cwd=tmp_path).returncode == 0
    program = tmp_path / "program"
    done = run("c++", main, *objects, "-o", program, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert read_numbers(program) == pytest.approx([LIGHT * WANTED, HEAVY * WANTED], rel=1e-14)


def test_every_symbol_has_the_tag_or_is_a_plain_name(place: Path, tmp_path: Path) -> None:
    """No definition of a C file that folders share has a name without the folder's tag."""
    objects = compile_folder(place / "a", tmp_path / "objects")
    listed = run("nm", "--defined-only", *objects, cwd=tmp_path).stdout.splitlines()
    symbols = {parts[2] for line in listed if len(parts := line.split()) == 3 and parts[1] in "TDBRVC"}
    manifest = read(place / "a" / FILE_NAME)
    plain = {s for s in symbols if not s.startswith(f"{manifest.symbols}_")}
    ends = (
        "",
        *(f"_{x}" for x in ["n_in", "n_out", "name_in", "name_out", "sparsity_in", "sparsity_out", "diff_in", "work"]),
    )
    assert plain == {f"{k.symbol}{end}" for k in manifest.kernels for end in ends} | {
        *(k.function for k in manifest.kernels),
        "arm_default_parameters",
    }


def test_the_same_content_has_the_same_tag(place: Path) -> None:
    """The tag depends on nothing but the C."""
    write(place, "again", LIGHT)
    assert read(place / "again" / FILE_NAME).symbols == read(place / "a" / FILE_NAME).symbols
    assert read(place / "b" / FILE_NAME).symbols != read(place / "a" / FILE_NAME).symbols


@pytest.mark.parametrize("prefix", ["", "m", "2arm", "left arm", "_arm", "arm_", "Zeta", "stdio", "a" * 40, "x_jac"])
def test_a_prefix_is_an_identifier_of_its_own(prefix: str) -> None:
    """A prefix that would be mangled as a name is refused."""
    with pytest.raises(OptionError, match=r"^prefix: .* cannot begin the names in C; give at most 34 letters"):
        check_prefix(prefix)


def test_a_mangled_name_is_said(tmp_path: Path) -> None:
    """Whoever generates from the model `m` looks for m.h: the command says the name that names begin with."""
    model = tmp_path / "m.yaml"
    model.write_text(MODEL.format(name="m", mass=1))
    options = ["--functions", "impl", "--derivatives", "0"]
    out = str(tmp_path / "out")
    done = CliRunner().invoke(cli, ["generate", str(model), "-o", out, *options])
    assert done.exit_code == 0, done.output
    assert "note: names in C begin with Z6dz, since 'm' cannot begin them; choose other ones by --prefix" in done.stderr
    done = CliRunner().invoke(cli, ["generate", str(model), "-o", out, *options, "--prefix", "mass"])
    assert done.exit_code == 0, done.output
    assert "note:" not in done.stderr
    assert (tmp_path / "out" / "mass.h").exists()
    assert describe_mangling("arm", "arm") == ""
