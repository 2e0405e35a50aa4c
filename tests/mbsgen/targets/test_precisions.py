"""One folder compiled in double and in single precision, in one program: each caller gets its own numbers."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from mbsgen.manifest import FILE_NAME, Manifest, read
from tests.mbsgen.targets.compilation import Requires
from tests.mbsgen.targets.pendulums import CASADI, HEAVY, TYPED, UNIT, WANTED, compile_folder, write
from tests.mbsgen.targets.programs import read_numbers, run

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wundef", "-Werror", "-O0")
MAIN = """\
#include <stdio.h>
double with_doubles(void), with_floats(void);
int main(void) { printf("%.17g %.17g\\n", with_doubles(), with_floats()); return 0; }
"""
UNITS = {"double": "with_doubles", "float": "with_floats"}
CPP = """\
#include "a/arm.hpp"
#include <array>
extern "C" double {function}() {{
    arm_model m;
    const std::array<mbs_real, 1> q{{mbs_real(0.5)}}, rest{{0}};
    return m.impl(q, rest, rest, rest)[0];
}}
"""
SINGLE = 1e-6  # 10 operations, each rounded to 6e-8


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder, and its objects and libraries in both precisions."""
    place = tmp_path_factory.mktemp("precisions")
    write(place, "a", HEAVY)
    (place / "main.c").write_text(MAIN)
    for real in UNITS:
        objects = compile_folder(place / "a", place / real, f"-DMBS_REAL={real}", "-fPIC")
        assert run("ar", "rc", place / f"lib{real}.a", *objects, cwd=place).returncode == 0
        done = run("cc", "-shared", *objects, "-lm", "-o", place / f"lib{real}.so", cwd=place)
        assert done.returncode == 0, done.stderr
    return place


def compile_units(place: Path, tmp_path: Path, call: str) -> list[Path]:
    """Compile a caller in each precision, each with the folder's header."""
    objects = []
    for real, function in UNITS.items():
        source, target = tmp_path / f"{function}.c", tmp_path / f"{function}.o"
        text = call.format(prefix="arm")
        source.write_text(UNIT.format(folder="a", prefix="arm", function=function, call=text))
        done = run("cc", *STRICT, f"-DMBS_REAL={real}", f"-I{place}", "-c", source, "-o", target, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        objects.append(target)
    return objects


@pytest.mark.parametrize("call", [TYPED, CASADI], ids=["typed", "casadi"])
@pytest.mark.parametrize(
    "parts", [("libdouble.a", "libfloat.a"), ("libfloat.a", "libdouble.a"), ("libfloat.so", "libdouble.so"), ()]
)
def test_both_precisions_live_in_one_program(place: Path, tmp_path: Path, parts: tuple[str, ...], call: str) -> None:
    """Libraries in any order, and all objects of both: the torque of gravity is right in each precision."""
    linked = [place / part for part in parts] or [p for real in UNITS for p in sorted((place / real).glob("*.o"))]
    units, program = compile_units(place, tmp_path, call), tmp_path / "program"
    done = run("cc", place / "main.c", *units, *linked, "-lm", "-o", program, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    doubles, floats = read_numbers(program)
    assert doubles == pytest.approx(HEAVY * WANTED, rel=1e-14)
    assert floats == pytest.approx(HEAVY * WANTED, rel=SINGLE)
    assert floats != pytest.approx(HEAVY * WANTED, rel=1e-14), "computed with doubles"


def test_a_caller_in_the_other_precision_does_not_link(place: Path, tmp_path: Path) -> None:
    """A caller with doubles would read numbers of half the size."""
    units = compile_units(place, tmp_path, TYPED)
    done = run("cc", place / "main.c", *units, place / "libfloat.a", "-lm", "-o", tmp_path / "program", cwd=tmp_path)
    assert done.returncode != 0
    assert re.search(r"undefined .*arm_\w+_compute_impl", done.stderr, re.IGNORECASE)


def test_inline_functions_of_cpp_have_the_precision(place: Path, tmp_path: Path) -> None:
    """A constructor of one name in two files is one function, of either file."""
    objects = []
    for real, function in UNITS.items():
        source = tmp_path / f"{function}.cpp"
        source.write_text(CPP.format(function=function))
        objects.append(tmp_path / f"{function}.o")
        command = ("c++", "-std=c++17", "-O0", f"-DMBS_REAL={real}", f"-I{place}", "-c", source, "-o", objects[-1])
        done = run(*command, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    main, program = tmp_path / "main.o", tmp_path / "program"
    assert run("cc", "-c", place / "main.c", "-o", main, cwd=tmp_path).returncode == 0
    libraries = (place / "libfloat.a", place / "libdouble.a")
    done = run("c++", main, *objects, *libraries, "-lm", "-o", program, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    doubles, floats = read_numbers(program)
    assert doubles == pytest.approx(HEAVY * WANTED, rel=1e-14)
    assert floats == pytest.approx(HEAVY * WANTED, rel=SINGLE)


def list_symbols(folder: Path) -> set[str]:
    """List what objects define for others, `main` of programs aside."""
    listed = run("nm", "--defined-only", "--extern-only", *sorted(folder.glob("*.o")), cwd=folder).stdout.splitlines()
    return {parts[2] for line in listed if len(parts := line.split()) == 3} - {"main"}


def test_no_name_is_in_both_precisions(place: Path) -> None:
    """Names of doubles are as they were; in single precision each says so, also for programs that load."""
    doubles, floats = list_symbols(place / "double"), list_symbols(place / "float")
    assert len(doubles) == len(floats) > 0
    assert {name.replace("_float", "") for name in floats} == doubles
    assert doubles & floats == set()
    manifest: Manifest = read(place / "a" / FILE_NAME)
    assert {kernel.symbol for kernel in manifest.kernels} <= doubles
    assert {kernel.single_symbol for kernel in manifest.kernels} <= floats


def test_libraries_of_cmake_in_both_precisions(place: Path, tmp_path: Path, requires: Requires) -> None:
    """Two builds of one folder by CMake."""
    cmake, libraries = requires("cmake"), []
    for real in UNITS:
        out = tmp_path / real
        flags = (f"-DCMAKE_C_FLAGS=-DMBS_REAL={real}", "-DCMAKE_BUILD_TYPE=Debug")
        assert run(cmake, "-S", place / "a", "-B", out, *flags, cwd=tmp_path).returncode == 0
        assert run(cmake, "--build", out, "--target", "arm", cwd=tmp_path).returncode == 0
        libraries.append(out / "libarm.a")
    units, program = compile_units(place, tmp_path, TYPED), tmp_path / "program"
    done = run("cc", place / "main.c", *units, *libraries, "-lm", "-o", program, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert read_numbers(program) == pytest.approx([HEAVY * WANTED] * 2, rel=SINGLE)
