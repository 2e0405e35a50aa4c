"""The evaluator of tables under sanitizers, in a separate program with memory of exactly the bytes asked for."""

from __future__ import annotations

import os
import subprocess
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from mbsgen import resources
from mbsgen.manifest import FILE_NAME, read
from mbsrun.controllers.arrays import Arrays, write_kinds
from mbsrun.controllers.sources import name_kernel, read_kernels
from mbsrun.external import load_on_demand
from mbsrun.library import find_compiler
from mbsrun.models import Extent, find_folder
from mbsrun.ocp.evaluation.stages import formulas
from mbsrun.ocp.evaluation.stages.binding import Evaluator, list_lifted
from mbsrun.ocp.evaluation.stages.building import build
from mbsrun.ocp.evaluation.stages.calls import name_called
from mbsrun.ocp.evaluation.stages.tables import FormulaFunction, KernelFunction, StageProgram
from mbsrun.ocp.ground.functions import Array
from mbsrun.ocp.problem.problem import Constraint, Cost, Term
from mbsrun.ocp.transcription.transcription import transcribe
from tests.mbsrun.ocp.plants import push
from tests.mbsrun.ocp.stages.stage_functions import compare

EPSILON = np.finfo(np.float64).eps
MASS = """
name: mass
gravity: [0, 0, 0]
bodies:
  - {name: slide, joint: {type: prismatic, axis: x}, mass: 1}
"""
FLAGS = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-O1", "-fsanitize=address,undefined")
MAIN = r"""
#include "mbs_program.h"
#include <stdio.h>
#include <stdlib.h>

static mbs_stages_real *read(int n)
{
    mbs_stages_real *a = malloc((size_t)(n > 0 ? n : 1) * sizeof *a);
    int i;
    for (i = 0; i < n; ++i)
        if (scanf("%lf", &a[i]) != 1)
            exit(2);
    return a;
}

static void show(mbs_stages_real *a, int n)
{
    int i;
    for (i = 0; i < n; ++i)
        printf("%.17g\n", a[i]);
    free(a);
}

/* Reads: which function, stage, parameters, numbers of all stages, x and v, sizes of the results, multipliers. */
int main(void)
{
    int which, k, sizes[4], i, status = 2;
    void *memory = malloc(mbs_program_bytes(&program));
    mbs_program_instance *p = mbs_program_create(&program, memory);
    mbs_stages_real *parameters, *numbers, *x, *v, *y[4], *out[4];
    const mbs_stages_size *size;
    if (scanf("%d %d %d %d %d %d", &which, &k, &sizes[0], &sizes[1], &sizes[2], &sizes[3]) != 6)
        return 2;
    size = &program.kind[program.kind_of_stage[k]].size;
    p->parameters = parameters = read(program.parameters);
    p->numbers = numbers = read(program.stages * program.numbers);
    x = read(size->nx);
    v = read(size->nv);
    for (i = 0; i < 4; ++i)
        out[i] = calloc((size_t)(sizes[i] > 0 ? sizes[i] : 1), sizeof *out[i]);
    if (which == 0)
        status = mbs_program_values(p, k, x, v, out[0], out[1], out[2], out[3]);
    if (which == 1)
        status = mbs_program_jacobians(p, k, x, v, out[0], out[1], out[2], out[3]);
    if (which == 2) {
        for (i = 0; i < 4; ++i)
            y[i] = read(i == 0 ? 1 : i == 1 ? size->ne : i == 2 ? sizes[1] : size->ng);
        status = mbs_program_hessian(p, k, x, v, *y[0], y[1], y[2], y[3], out[0]);
        sizes[1] = 0;
        for (i = 0; i < 4; ++i)
            free(y[i]);
    }
    for (i = 0; i < 4; ++i)
        show(out[i], sizes[i]);
    free(x);
    free(v);
    free(parameters);
    free(numbers);
    free(memory);
    return status;
}
"""


class Apart(Evaluator):
    """An evaluator whose functions are calls of a program."""

    def __init__(self, program: Path, data: StageProgram, parameters: Array) -> None:
        self.tables = SimpleNamespace(data=data, lifted=list_lifted(data))  # type: ignore[assignment]
        self.program, self.parameters = program, parameters

    def run(self, which: int, k: int, sizes: tuple[int, ...], xv: Array, more: Array) -> list[Array]:
        """Call a function; return its results."""
        given = np.concatenate((self.parameters, self.tables.data.numbers.ravel(), xv, more))
        words = [which, k, *sizes, *(repr(float(x)) for x in given)]
        text = " ".join(map(str, words))
        done = subprocess.run([str(self.program)], input=text, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return np.split(np.array(done.stdout.split(), dtype=np.float64), np.cumsum(sizes)[:-1])

    def values(self, k: int, xv: Array) -> tuple[float, Array, Array, Array]:
        f, e, d, g = self.run(0, k, (1, *self.rows(k)), xv, np.zeros(0))
        return float(f[0]), e, d, g

    def jacobians(self, k: int, xv: Array) -> tuple[Array, Array, Array, Array]:
        kind = self._kind(k)
        sizes = (xv.size, kind.de.row.size, kind.dd.row.size, kind.dg.row.size)
        df, de, dd, dg = self.run(1, k, sizes, xv, np.zeros(0))
        return df, de, dd, dg

    def hessian(self, k: int, xv: Array, factor: float, y: Array) -> Array:
        nonzeros = self._kind(k).hessian.row.size
        return self.run(2, k, (nonzeros, self.rows(k)[1], 0, 0), xv, np.array([factor, *y]))[0]


def write_program(data: StageProgram, names: tuple[str, ...]) -> str:
    """Write tables, and a program that evaluates them."""
    arrays = Arrays("t", lambda words: (", ".join(words),))
    kinds = ", ".join(f"{{{kind}}}" for kind in write_kinds(data, arrays).kinds)
    scripts = [script for kind in data.kinds for script in kind.scripts]
    calls = [step.call for script in scripts for step in script.steps if step.call is not None]
    arguments, results = max(len(call.arguments) for call in calls), max(len(call.results) for call in calls)
    parameters = data.parameters + sum(given.size for given in data.given)
    lines = [
        '#include "mbs_program.h"',
        *(f"int {x}(const double **arg, double **res, long long int *iw, double *w, int mem);" for x in names),
        *(f"{x.declaration} = {{{x.lines[0]}}};" for x in arrays.declared),
        f"static const mbs_program_function functions[] = {{{', '.join(names)}}};",
        f"static const mbs_program_kind kinds[] = {{{kinds}}};",
        f"static const int kind_of_stage[] = {{{', '.join(map(str, data.kind_of_stage))}}};",
        f"static const mbs_program program = {{{len(data.kind_of_stage)}, {len(data.kinds)}, kind_of_stage, kinds,",
        f"    {parameters}, {data.numbers.shape[1]}, functions, {arguments}, {results}, 0, 0}};",
    ]
    return "\n".join(lines) + MAIN


def test_sanitizers_find_nothing(tmp_path: Path) -> None:
    """Kernels, and expressions with parameters, numbers of stages, a factor and carried inputs: results are NumPy's."""
    model = tmp_path / "mass.yaml"
    model.write_text(MASS, encoding="utf-8")
    plant = load_on_demand(model)
    problem = replace(
        push(3),
        horizon_range=(0.5, 2.0),
        constants=(("a", 0.3),),
        cost=Cost(1.0, 0.5, (Term("q_slide*u_slide*t + a*qd_slide**2", 2.0),), (Term("T**2*q_slide", 0.7),)),
        constraints=(Constraint("q_slide - a*t", (-1.0, 2.0)),),
    )
    transcription = transcribe(problem, plant)
    program, p, rng = transcription.program, transcription.parameters(problem), np.random.default_rng(0)
    data = build(program, plant)
    folder = find_folder(model, Extent(("impl",)))
    manifest = read(folder / FILE_NAME)
    called = {i: manifest.kernel(name_called(f)) for i, f in enumerate(data.functions) if isinstance(f, KernelFunction)}
    files = read_kernels(folder, manifest, called.values(), manifest.symbols)
    own = {i: name_kernel(kernel, manifest, manifest.symbols) for i, kernel in called.items()}
    names = tuple(own.get(i, f"f{i}") for i in range(len(data.functions)))
    for name, function in zip(names, data.functions, strict=True):
        if isinstance(function, FormulaFunction):
            files[f"{name}.c"] = formulas.write(function.formula, name, function.derivative)
    for name, text in {**files, "program.c": write_program(data, names)}.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    csrc = resources.folder("csrc")
    sources = [csrc / "program" / "mbs_program.c", *sorted(tmp_path.glob("*.c"))]
    flags = [*FLAGS, f"-I{csrc / 'program'}", f"-I{csrc / 'stages'}", f"-I{csrc}"]
    command = [*find_compiler(os.environ).command, *flags, *map(str, sources), "-lm", "-o", str(tmp_path / "program")]
    subprocess.run(command, check=True)
    x = rng.uniform(0.3, 1.0, program.variables)
    found = compare(Apart(tmp_path / "program", data, p), program, plant, x, p, rng)
    assert max(found.values, found.slopes, found.curvatures) < 100 * EPSILON
