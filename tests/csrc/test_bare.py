"""The solver on a bare Cortex-M7 under QEMU, in single precision."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mbsgen.resources import folder
from mbsrun import bare
from tests.csrc.stages import STRICT, sources

CSRC = folder("csrc")
EXAMPLE = CSRC / "stages" / "example"
WARNED = (*STRICT, "-Wdouble-promotion", "-Wfloat-conversion")
SOLVER = ("-DMBS_STAGES_FLOAT", f"-I{CSRC / 'stages'}")
Program = Callable[..., bare.Image]

MATHEMATICS = {"logf", "log10f", "powf", "sqrtf", "memcpy", "memmove", "memset"}
CLOCK = {"__aeabi_dsub", "__aeabi_dcmpge", "__aeabi_dcmpgt"}  # double precision by software
ALLOCATION = ("malloc", "calloc", "realloc", "free", "sbrk", "printf", "fopen")


@pytest.fixture(scope="module")
def program(requires: Callable[[str], str], tmp_path_factory: pytest.TempPathFactory) -> Program:
    """Return the compiler of bare programs, which is given sources or text; skip without the tools."""
    for tool in bare.PACKAGES:
        requires(tool)
    place = tmp_path_factory.mktemp("bare")

    def build(text: str | None, *sources: Path, flags: tuple[str, ...] = (), unit: str = bare.SINGLE) -> bare.Image:
        files = list(sources)
        if text is not None:
            files.append(place / "program.c")
            files[-1].write_text(text, "utf-8")
        return bare.build(files, place / f"{len(list(place.iterdir()))}.elf", [*STRICT, *flags], unit)

    return build


COUNTED = r"""
#include "mbs_bare.h"
#include <math.h>
static const float table[] = {1, -2.5f, 3e-40f, 0, INFINITY, -INFINITY, NAN};
static int written = 7, zero;
static int deep(int n)
{
    volatile char part[96];
    part[0] = (char)n;
    return n > 0 ? deep(n - 1) + part[0] : 0;
}
int main(void)
{
    unsigned long before, after;
    int i;
    for (i = 0; i < 7; ++i)
        mbs_bare_print_float("float", table[i]);
    before = mbs_bare_instructions();
    __asm__ volatile("movw r0, #%d\n1: subs r0, r0, #1\n\tbne 1b" ::: "r0", "cc");
    after = mbs_bare_instructions();
    mbs_bare_print_integer("counted", (long)(after - before));
    mbs_bare_print_integer("integer", written);
    mbs_bare_print_integer("integer", zero);
    mbs_bare_print_integer("integer", -2147483647 - 1);
    return deep(%d) & 31;
}
"""


def test_output_instructions_and_stack_of_a_known_program(program: Program) -> None:
    """A loop of n turns is 2 n instructions; 100 frames hold 96 bytes each and some registers."""
    counts = {}
    for turns, depth in ((100, 1), (60_100, 101)):
        image = program(COUNTED % (turns, depth))
        found = bare.run(image.path)
        assert found == bare.run(image.path)
        assert found.status == depth * (depth + 1) // 2 & 31
        counts[turns] = (found.numbers("counted")[0], found.stack)
    assert counts[60_100][0] - counts[100][0] == pytest.approx(120_000, abs=1)
    assert 9600 <= counts[60_100][1] - counts[100][1] <= 100 * 128
    assert found.numbers("float")[:4] == [1.0, -2.5, float(np.float32(3e-40)), 0.0]
    assert [str(x) for x in found.numbers("float")[4:]] == ["inf", "-inf", "nan"]
    assert found.numbers("integer") == [7, 0, -(2**31)]


def test_a_fault_and_a_program_without_end_are_errors(program: Program) -> None:
    """An overflow of the stack, which lies at the lowest address; a loop."""
    overflow = program(COUNTED % (1, 250), flags=("-Wl,--defsym=stack_bytes=8192",))
    with pytest.raises(bare.BareError, match=r"fault, such as an overflow of its stack, with status 99"):
        bare.run(overflow.path)
    endless = program("int main(void) { for (;;) continue; }")
    with pytest.raises(bare.BareError, match=r"does not end within 0.5 s"):
        bare.run(endless.path, seconds=0.5)


def test_a_program_that_allocates_does_not_link(program: Program) -> None:
    with pytest.raises(bare.BareError, match="_sbrk"):
        program("#include <stdlib.h>\nint main(void) { return malloc(8) != 0; }")


def test_a_missing_tool_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(bare.BareError, match=r"qemu-system-arm is not on the PATH; install qemu-system-arm"):
        bare.run(tmp_path / "image")


@pytest.fixture(scope="module")
def pendulum(program: Program) -> bare.Image:
    files = [*sources(), EXAMPLE / "pendulum.c", EXAMPLE / "bare.c"]
    return program(None, *files, flags=(*SOLVER, *WARNED))


def test_the_pendulum_swings_up_on_the_bare_machine(pendulum: bare.Image, tmp_path: Path) -> None:
    """With the optimum of a solve on the host in the same precision, to its digits; in a known memory."""
    found = bare.run(pendulum.path)
    assert found == bare.run(pendulum.path)
    assert found.status == 0
    assert "The optimality conditions hold to the tolerance." in found.output
    command = ["cc", *STRICT, *SOLVER, *map(str, [*sources(), EXAMPLE / "pendulum.c", EXAMPLE / "main.c"]), "-lm"]
    subprocess.run([*command, "-o", str(tmp_path / "main")], check=True)
    host = subprocess.run([str(tmp_path / "main")], check=True, capture_output=True, text=True).stdout.split()
    assert found.numbers("effort") == pytest.approx([float(host[host.index("effort") + 1])], rel=1e-6)
    angles = [float(host[i + 1]) for i, word in enumerate(host) if word == "angle"]
    assert found.numbers("angle") == pytest.approx(angles, abs=2e-4)
    assert found.numbers("bytes")[0] < 110_000
    assert found.stack < 4096


def test_the_image_holds_no_allocation(pendulum: bare.Image) -> None:
    """And no input or output of newlib."""
    assert "mbs_stages_solve" in pendulum.symbols
    assert not {name for name in pendulum.symbols if name.strip("_").startswith(ALLOCATION)}


@pytest.mark.parametrize("unit", [bare.SINGLE, bare.DOUBLE])
def test_the_solver_needs_the_mathematical_library_alone(
    requires: Callable[[str], str], tmp_path: Path, unit: str
) -> None:
    """In single precision: on a processor without double precision, its software does the clock alone."""
    requires(bare.COMPILER)
    needs = bare.find_needs(sources(), tmp_path, [*WARNED, *SOLVER], unit)
    assert needs - MATHEMATICS == (CLOCK if unit == bare.SINGLE else set())
