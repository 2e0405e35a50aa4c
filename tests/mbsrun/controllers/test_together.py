"""Controllers of several folders in one program: each solves its own problem, or the program is not built."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import pytest
from click.testing import CliRunner

from mbsgen.request import OptionError
from mbsrun.cli import cli
from mbsrun.controllers.folder import read
from mbsrun.controllers.making import choose_name
from tests.mbsgen.targets.programs import read_numbers, run

CC = ("cc", "-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-O0")
MODEL = """\
name: cart
gravity: [0, 0, -9.81]
bodies:
  - {{name: cart, joint: {{name: x, type: prismatic, axis: x}}, mass: {mass}}}
"""
PROBLEM = """\
model: cart.yaml
horizon: 1
intervals: 4
scheme: legendre
degree: 3
cost: {inputs: 1}
start: {pose: {x: 0}}
end: {pose: {x: 1}}
"""
LIGHT, HEAVY = 1.0, 3.0  # kg

# A C file that solves one folder's problem; a workspace of its size is static.
UNIT = """\
#include "{folder}/{prefix}.h"
double {function}(void);
double {function}(void)
{{
    static double memory[40000];
    {prefix} *c = {prefix}_create(memory, sizeof memory);
    double cost;
    if (c == NULL || {prefix}_solve(c, NULL) != MBS_STAGES_SOLVED)
        return -1;
    cost = {prefix}_get_result(c)->cost;
    {prefix}_end(c);
    return cost;
}}
"""
MAIN = """\
#include <stdio.h>
double light(void), heavy(void);
int main(void) { printf("%.17g %.17g\\n", light(), heavy()); return 0; }
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Controllers of one name for carts of two masses, and one of the second cart with another prefix."""
    place = tmp_path_factory.mktemp("controllers")
    for folder, mass, options in (("a", LIGHT, ()), ("b", HEAVY, ()), ("c", HEAVY, ("--prefix", "heavy_reach"))):
        made = place / f"of_{folder}"
        made.mkdir()
        (made / "cart.yaml").write_text(MODEL.format(mass=mass))
        problem = made / "reach.ocp.yaml"
        problem.write_text(PROBLEM)
        done = CliRunner().invoke(cli, ["controller", str(problem), "-o", str(place / folder), *options])
        assert done.exit_code == 0, done.output
    for name, folder, prefix in (("light", "a", "reach"), ("heavy", "b", "reach"), ("other", "c", "heavy_reach")):
        function = "heavy" if name == "other" else name
        (place / f"{name}.c").write_text(UNIT.format(folder=folder, prefix=prefix, function=function))
    (place / "main.c").write_text(MAIN)
    return place


@cache
def compile_folder(place: Path, folder: str, *flags: str) -> tuple[Path, ...]:
    """Compile each C file of a folder to an object, programs among them; once for all tests."""
    out = place / "".join(("objects_of_", folder, *flags))
    out.mkdir()
    sources = sorted((place / folder).glob("*.c"))
    done = subprocess.run([*CC, *flags, "-c", *sources], cwd=out, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return tuple(out / f"{source.stem}.o" for source in sources)


def link(place: Path, out: Path, units: Sequence[str], parts: Sequence[Path]) -> subprocess.CompletedProcess[str]:
    """Link the main program and units of `place` with objects or libraries."""
    sources = [place / f"{name}.c" for name in ("main", *units)]
    return run(*CC, f"-I{place}", *sources, *parts, "-lm", "-o", out / "program", cwd=out)


def expect(mass: float) -> float:
    """Return the least cost of moving a mass by 1 m in 1 s, by four constant inputs: m^2 h / sum of a_k^2.

    An input of 1 N in interval k moves 1 kg by a_k = h (1 - (k + 1/2) h).
    """
    h = 0.25
    return mass**2 * h / sum((h * (1 - (k + 0.5) * h)) ** 2 for k in range(4))


def test_all_files_of_two_controllers_make_one_program(place: Path, tmp_path: Path) -> None:
    """Kernels of one model, the solver, examples and checks are in both folders."""
    objects = [*compile_folder(place, "a"), *compile_folder(place, "c")]
    done = link(place, tmp_path, ("light", "other"), objects)
    assert done.returncode == 0, done.stderr
    assert read_numbers(tmp_path / "program") == pytest.approx([expect(LIGHT), expect(HEAVY)], rel=1e-6)


def test_objects_of_one_name_clash_or_keep_their_numbers(place: Path, tmp_path: Path) -> None:
    """Programs that see each folder by its header compute with its own numbers, even where the names are the same."""
    objects = [*compile_folder(place, "a"), *compile_folder(place, "b")]
    done = link(place, tmp_path, ("light", "heavy"), objects)
    assert done.returncode == 0, done.stderr
    assert read_numbers(tmp_path / "program") == pytest.approx([expect(LIGHT), expect(HEAVY)], rel=1e-6)


@pytest.mark.parametrize("kind", ["static", "shared"])
def test_libraries_of_one_name_keep_their_numbers(place: Path, tmp_path: Path, kind: str) -> None:
    """Linkers take the first definition of a symbol that they find, the solver's too."""
    libraries = []
    for folder in "ab":
        objects = compile_folder(place, folder, "-fPIC")
        libraries.append(tmp_path / f"lib{folder}.{'a' if kind == 'static' else 'so'}")
        command = ("ar", "rc") if kind == "static" else ("cc", "-shared", "-o")
        assert run(*command, libraries[-1], *objects, cwd=tmp_path).returncode == 0
    done = link(place, tmp_path, ("light", "heavy"), libraries)
    assert done.returncode == 0, done.stderr
    assert read_numbers(tmp_path / "program") == pytest.approx([expect(LIGHT), expect(HEAVY)], rel=1e-6)


@pytest.mark.parametrize("order", ["double first", "single first"])
def test_a_controller_in_both_precisions_makes_one_program(place: Path, tmp_path: Path, order: str) -> None:
    """Linkers take the first library that has a name; the names of each precision are separate."""
    units, libraries = [], []
    for function, flags in (("heavy", ()), ("light", ("-DMBS_STAGES_FLOAT",))):
        unit = tmp_path / f"{function}.c"
        unit.write_text(UNIT.format(folder="b", prefix="reach", function=function))
        objects = compile_folder(place, "b", *flags)
        units.append(tmp_path / f"{function}.o")
        libraries.append(tmp_path / f"lib{function}.a")
        assert run("ar", "rc", libraries[-1], *objects, cwd=tmp_path).returncode == 0
        done = run(*CC, *flags, f"-I{place}", "-c", unit, "-o", units[-1], cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    done = link(place, tmp_path, (), [*units, *(libraries if order == "double first" else reversed(libraries))])
    assert done.returncode == 0, done.stderr
    single, double = read_numbers(tmp_path / "program")
    assert double == pytest.approx(expect(HEAVY), rel=1e-6)
    assert single == pytest.approx(expect(HEAVY), rel=1e-3)
    assert abs(single - double) > 1e-7 * double


def test_headers_of_one_name_and_other_content_stop_the_compiler(place: Path, tmp_path: Path) -> None:
    """The guard of the first header would hide the second one."""
    unit = tmp_path / "unit.c"
    unit.write_text('#include "a/reach.h"\n#include "b/reach.h"\n')
    done = run(*CC, f"-I{place}", "-c", unit, cwd=tmp_path)
    assert done.returncode != 0
    assert "two controllers are called reach: write one of them with --prefix NAME" in done.stderr
    unit.write_text('#include "a/reach.h"\n#include "a/reach.h"\n#include "c/heavy_reach.h"\n')
    assert run(*CC, f"-I{place}", "-c", unit, cwd=tmp_path).returncode == 0


def test_another_version_of_the_solver_stops_the_compiler(place: Path, tmp_path: Path) -> None:
    """Results of two versions may have other fields; one file cannot see both."""
    header = tmp_path / "mbs_stages.h"
    text = (place / "a" / "mbs_stages.h").read_text()
    line = next(line for line in text.splitlines() if line.startswith("#define MBS_STAGES_CONTENT "))
    header.write_text(text.replace(line, "#define MBS_STAGES_CONTENT 0x12345678"))
    unit = tmp_path / "unit.c"
    unit.write_text('#include "mbs_stages.h"\n#include "a/reach.h"\n')
    done = run(*CC, f"-I{place}", "-c", unit, cwd=tmp_path)
    assert done.returncode != 0
    assert "reach has another version of mbs_stages.h" in done.stderr


def test_every_symbol_has_the_tag(place: Path, tmp_path: Path) -> None:
    """No definition has a name that another folder may have, `main` of the programs aside."""
    objects = compile_folder(place, "a")
    listed = run("nm", "--defined-only", *objects, cwd=tmp_path).stdout.splitlines()
    symbols = {parts[2] for line in listed if len(parts := line.split()) == 3 and parts[1] in "TDBRVC"}
    own = read(place / "a").symbols
    assert symbols
    assert {s for s in symbols if f"{own}_" not in s} == set()


def test_a_prefix_is_not_the_models() -> None:
    """Kernels in the folder begin with the model's name."""
    with pytest.raises(OptionError, match="names of the model begin with cart; give another one"):
        choose_name("move", "cart", "cart")
    assert choose_name("move", "cart", "left") == "left"
    with pytest.raises(OptionError, match="'worker' cannot begin the names in C"):
        choose_name("move", "cart", "worker")


@pytest.mark.parametrize("name", ["move", "control", "worker", "take", "double", "printf", "main", "cart"])
def test_a_controller_is_not_called_as_anything_in_its_c(name: str) -> None:
    """A problem's name becomes a type in C, which no function around it may be called as."""
    assert choose_name(name, "cart") == f"{name}_controller"
    assert choose_name("reach", "cart") == "reach"
