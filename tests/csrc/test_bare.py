"""The solver on a bare Cortex-M7 under QEMU, in single precision."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mbsgen.resources import folder
from mbsrun import bare
from mbsrun.stack import Rules, find_deepest, list_tasks
from tests.csrc.stages import STATUS, STRICT, sources
from tests.graphs import compile_graphs

CSRC = folder("csrc")
EXAMPLE = CSRC / "stages" / "example"
WARNED = (*STRICT, "-Wdouble-promotion", "-Wfloat-conversion")
SOLVER = ("-DMBS_STAGES_FLOAT", f"-I{CSRC / 'stages'}", f"-I{EXAMPLE}")
Program = Callable[..., bare.Image]

SINES = {"sinf", "cosf"}  # of the pendulum
MATHEMATICS = {"logf", "log10f", "powf", "memcpy", "memmove", "memset"} | SINES
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
def solver(requires: Callable[[str], str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the solver and the pendulum's functions as an object of single precision."""
    requires(bare.COMPILER)
    files = [*sources(), EXAMPLE / "pendulum.c"]
    return bare.compile_object(files, tmp_path_factory.mktemp("solver") / "solver.o", [*WARNED, *SOLVER])


@pytest.fixture(scope="module")
def pendulum(program: Program, solver: Path) -> bare.Image:
    return program(None, solver, EXAMPLE / "bare.c", flags=SOLVER)


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
    assert found.numbers("bytes")[0] < 133_000
    assert found.stack < 4096


LIMITS = r"""
#include "mbs_bare.h"
#include "pendulum.h"
static char workspace[400 * 1024] __attribute__((aligned(16)));
static pendulum problem;
static int nothing(void *context, int k, const mbs_stages_real *x, const mbs_stages_real *v, mbs_stages_real *f,
                   mbs_stages_real *e, mbs_stages_real *d, mbs_stages_real *g)
{
    (void)context, (void)k, (void)x, (void)v, (void)e, (void)d, (void)g;
    *f = k == 7 ? (mbs_stages_real)NAN : 0;
    return 0;
}
int main(void)
{
    static const mbs_stages_real torques[] = {4, (mbs_stages_real)0.2, -1};
    mbs_stages_result result;
    int i;
    for (i = 0; i < 4; ++i) {
        mbs_stages *solver;
        pendulum_describe(&problem, torques[i % 3]);
        if (i == 3)
            problem.problem.values = nothing;
        solver = mbs_stages_create(&problem.problem, workspace, sizeof workspace);
        if (solver == NULL)
            return 1;
        result = mbs_stages_solve(solver, NULL);
        mbs_bare_print_integer("status", result.status);
        mbs_bare_print_integer("stage", result.stage);
        mbs_bare_print_integer("clashes", result.clashes);
    }
    return 0;
}
"""


def test_statuses_on_the_bare_machine(program: Program, solver: Path) -> None:
    """Solved, infeasible, bounds that cross, no number at the guess: each by its status, with its stage."""
    image = program("#include <math.h>\n" + LIMITS, solver, flags=SOLVER)
    found = bare.run(image.path)
    assert found.status == 0
    assert [STATUS[int(x)] for x in found.numbers("status")] == [
        "solved",
        "infeasible",
        "bad problem",
        "callback failed",
    ]
    assert found.numbers("stage") == [-1, -1, 0, 7]
    assert [x > 0 for x in found.numbers("clashes")] == [False, True, False, False]


def test_the_stack_is_bounded_by_call_graphs(pendulum: bare.Image, solver: Path, tmp_path: Path) -> None:
    """The bound of the cross-compiler's frames holds in a run and is near it; the host's frames are larger."""
    main = bare.compile_object([EXAMPLE / "bare.c"], tmp_path / "main.o", [*SOLVER, f"-I{CSRC / 'bare'}"])
    callbacks = [f"pendulum.c:{name}" for name in ("values", "jacobians", "hessian")]
    pointers = {"evaluate.c": callbacks, "finish.c": (), "solve.c": (), "realtime.c": (), "recursion.c": list_tasks()}
    rules = Rules(pointers, bare.LIBRARY, bare.OTHER, depth=2)
    target = bare.read_functions(solver)
    found = bare.run(pendulum.path).stack
    assert found <= bare.START + find_deepest({**target, **bare.read_functions(main)}, ["main"], rules).bytes
    host = compile_graphs(["gcc", "-std=c99", "-O2", *SOLVER], [*sources(), EXAMPLE / "pendulum.c"], tmp_path)
    roots = [f"mbs_stages_{name}_float" for name in ("create", "solve", "prepare", "feedback")]
    on_target, on_host = (find_deepest(functions, roots, rules).bytes for functions in (target, host))
    assert found / 2 <= on_target <= found
    assert on_target <= on_host <= 2 * on_target


@pytest.mark.parametrize(
    ("call", "bound"),
    [
        ("sinf(x)", bare.LIBRARY["sinf"]),
        ("cosf(x)", bare.LIBRARY["cosf"]),
        ("powf(x, y) + logf(x) + log10f(x) + sqrtf(x)", bare.OTHER),
        ("(float)(memmove(a, b, n) == memset(b, 1, n)) + (float)((double)x < (double)y - 1)", bare.OTHER),
    ],
)
def test_the_stack_of_the_library(program: Program, call: str, bound: int) -> None:
    """Sine reduces a large argument at most; the others need less."""
    image = program(
        '#include "mbs_bare.h"\n#include <math.h>\n#include <string.h>\n'
        "volatile float x = 1e30f, y = 2.3f, result; volatile unsigned n = 77; char a[100], b[100];\n"
        f"int main(void) {{ result = {call}; x = 0.7f; result += {call}; x = -200; result += {call}; return 0; }}\n"
    )
    assert bare.run(image.path).stack <= bare.START + 32 + bound


def test_the_image_holds_no_allocation(pendulum: bare.Image) -> None:
    """And no input or output of newlib."""
    assert "mbs_stages_solve_float" in pendulum.symbols
    assert not {name for name in pendulum.symbols if name.strip("_").startswith(ALLOCATION)}


def test_the_solver_needs_the_mathematical_library_alone(solver: Path) -> None:
    """The processor computes in single precision, and software in double precision for the clock alone."""
    assert bare.find_needs(solver) == MATHEMATICS | CLOCK


def test_two_precisions_need_no_software_of_numbers(requires: Callable[[str], str], tmp_path: Path) -> None:
    """A processor with both precisions computes all by itself, in double precision too."""
    requires(bare.COMPILER)
    made = bare.compile_object(sources(), tmp_path / "solver.o", [*STRICT, "-O1"], bare.DOUBLE)
    assert bare.find_needs(made) == {name.removesuffix("f") for name in MATHEMATICS - SINES}
