"""First derivatives by loops over tables: the straight code's, and Pinocchio's, for any tree, in C."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbsrun
from mbsgen.families import write_functions
from mbsgen.model.tree import Tree
from mbsgen.pipeline import Options, generate
from mbsgen.procedure.procedure import Computation, Procedure, evaluate
from mbsgen.request import CodeSize, Request
from tests.mbsgen.derivatives.evaluation import assert_pinocchios, matrix
from tests.random_trees import floating, random_tree, with_laws, with_rotors, with_wrenches

MODELS = Path(__file__).parents[3] / "models"
LOOPED, STRAIGHT = CodeSize(looped=0, compared=0), CodeSize(compared=0)
OPTIONS = Options(functions=("impl", "exp1"), derivatives=1, size=LOOPED)
TREES = {
    "all forces": with_wrenches(with_laws(with_rotors(random_tree(5, 7), 5)), 5),
    "run time": with_laws(random_tree(7, 4, runtime=True)),
    "floating": floating(random_tree(2, 3)),
}


def write(tree: Tree, size: CodeSize) -> dict[str, Computation]:
    """Return `impl` and `exp2` with their derivatives, and `setup`, by name."""
    request = Request(functions=("impl", "exp2"), derivatives=1, size=size)
    families = write_functions(tree, request, staged=True).families
    return {f.name: f for family in families for f in family.functions}


@pytest.mark.parametrize("name", TREES)
def test_loops_give_what_straight_code_gives(name: str) -> None:
    """Jacobian, adjoint and linearisation, to rounding."""
    rng = np.random.default_rng(1)
    looped, straight = write(TREES[name], LOOPED), write(TREES[name], STRAIGHT)
    values = {"p": list(rng.uniform(0.3, 1.2, looped["setup"].input("p").sparsity.nnz))} if "setup" in looped else {}
    for kernel in ("jac_exp2", "adj1_exp2", "lin_exp2", "jac_impl", "lin_impl"):
        assert isinstance(looped[kernel], Procedure)
        drawn = {i.name: list(rng.uniform(0.3, 1.2, i.sparsity.nnz)) for i in straight[kernel].inputs}
        dense = []
        for functions in (looped, straight):
            given = drawn | (evaluate(functions["setup"], values) if values else {})
            found = evaluate(functions[kernel], given)
            dense.append({o.name: matrix(functions[kernel], o.name, found) for o in functions[kernel].outputs})
        for result, expected in dense[1].items():
            np.testing.assert_allclose(
                dense[0][result], expected, rtol=0, atol=1e-11 * max(1.0, np.abs(expected).max())
            )


def test_loops_give_pinocchios_derivatives() -> None:
    """Against computeABADerivatives, scaled by the condition of M."""
    tree = with_rotors(random_tree(3, 8), 3)
    found = write(tree, LOOPED)["jac_exp2"]
    assert_pinocchios(tree, found, 3)


@pytest.mark.parametrize("model", ["branched", "six_axis"])
@pytest.mark.parametrize("kind", ["vectors", "scalars"])
def test_the_c_of_loops_gives_the_derivatives(
    kind: str, model: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the straight C does, of one state, of many in lanes, and without vectors; of sliding and of turning joints."""
    monkeypatch.setenv("CFLAGS", "-O1")
    found = []
    for size in (LOOPED, STRAIGHT):
        folder = tmp_path / str(size.looped)
        product = generate(MODELS / f"{model}.yaml", folder, replace(OPTIONS, size=size))
        assert ("mbs_dynamics.h" in product.files) == (size is LOOPED)
        if kind == "scalars" and size is LOOPED:
            header = folder / "mbs_columns.h"
            header.write_text(f"#define MBS_SCALAR\n{header.read_text()}")
        rng = np.random.default_rng(2)
        inputs = product.manifest.kernel("adj1_exp1").inputs
        state: dict[str, Any] = {i.name: rng.uniform(0.3, 1.2, (40, i.nnz)) for i in inputs if i.name != "h"}
        kernels = mbsrun.load(folder)
        seeds = {"adj_qdd": state.pop("adj_qdd")}
        one = {name: x[0] for name, x in state.items()}
        found.append(kernels.jac("exp1", **one) | kernels.lin("exp1", **one))
        found[-1] |= kernels.lin("impl", **one, qdd=rng.uniform(-1, 1, len(product.manifest.coordinates)))
        for name, more in (("jac_exp1", {}), ("adj1_exp1", seeds)):
            many, _ = kernels.batch(name, lanes=kind == "vectors", **state, **more)
            found[-1] |= {f"many {result}": values for result, values in many.items()}
    looped, straight = found
    assert looped.keys() == straight.keys()
    for result, expected in straight.items():
        scale = max(1.0, float(np.abs(expected).max(initial=0.0)))
        np.testing.assert_allclose(looped[result], expected, rtol=0, atol=1e-11 * scale)


@pytest.mark.parametrize(("compiler", "real"), [("gcc", "float"), ("clang", "double")])
def test_no_compiler_warns_of_tables(compiler: str, real: str, tmp_path: Path, requires: Callable[[str], str]) -> None:
    """With sanitizers as well, which the C passes at a state, and at one whose pivots fail."""
    generate(MODELS / "branched.yaml", tmp_path, OPTIONS)
    (tmp_path / "main.c").write_text(PROBE)
    strict = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror")
    options = (*strict, f"-DMBS_REAL={real}", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
    names = ("jac_exp1", "adj1_exp1", "setup", "default_parameters")
    files = [tmp_path / "main.c", *(tmp_path / f"branched_{name}.c" for name in names)]
    program = tmp_path / "probe"
    subprocess.run([requires(compiler), *options, *files, "-lm", "-o", program], check=True)
    assert subprocess.run([program], check=True, capture_output=True, text=True).stdout.split() == ["0", "1"]


PROBE = """
#include <math.h>
#include <stdio.h>

#include "branched.h"

/* The statuses at a state, and whether nothing is written at one that is not a number. */
int main(void)
{
    mbs_real q[7] = {0}, qd[7] = {0}, u[5] = {0}, seeds[7] = {1}, p[9], h[99], r[3][49];
    int i;
    branched_default_parameters(p);
    i = branched_compute_setup(p, h);
    i |= branched_compute_adj1_exp1(q, qd, u, seeds, h, r[0], r[1], r[2]);
    printf("%d ", i | branched_compute_jac_exp1(q, qd, u, h, r[0], r[1], r[2]));
    for (i = 0; i < 7; ++i)
        q[i] = (mbs_real)NAN;
    r[0][0] = 5;
    i = branched_compute_jac_exp1(q, qd, u, h, r[0], r[1], r[2]);
    printf("%d", i != 0 && r[0][0] == 5);
    return 0;
}
"""
