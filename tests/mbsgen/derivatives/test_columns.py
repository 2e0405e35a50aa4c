"""Jacobians of accelerations with a loop: what the straight code gives, in C, for trees of any shape."""

from __future__ import annotations

import platform
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbsrun
from mbsgen.families import write_families
from mbsgen.model.changes.scene import EVERYTHING
from mbsgen.model.tree import Tree
from mbsgen.pipeline import Options, generate
from mbsgen.procedure.procedure import evaluate
from mbsgen.request import CodeSize, merge
from tests.random_trees import random_tree

MODELS = Path(__file__).parents[3] / "models"
FLAGS = ("", "-mno-avx512f", "-mno-avx") if platform.machine() == "x86_64" else ("",)  # by the width of vectors
OPTIONS = Options(functions=("exp1",), derivatives=1, size=CodeSize(straight=0))  # every Jacobian has a loop


@pytest.mark.parametrize("tree", [random_tree(5, 6), random_tree(7, 5, runtime=True)], ids=["branched", "run time"])
def test_a_loop_gives_the_jacobian(tree: Tree) -> None:
    """To rounding, relative to the largest entry; with run-time numbers, after `setup`."""
    rng = np.random.default_rng(1)
    families = write_families(tree, merge(OPTIONS, EVERYTHING))
    (family,) = (f for f in families if f.value.name == "exp1")
    assert family.jac is not None
    staged = family.staged["jac_exp1"]
    drawn = {i.name: list(rng.uniform(0.3, 1.2, i.sparsity.nnz)) for i in family.jac.inputs}
    for setup in (f.value for f in families if f.value.name == "setup"):  # both forms need entries that belong together
        drawn |= evaluate(setup, {i.name: list(rng.uniform(0.3, 1.2, i.sparsity.nnz)) for i in setup.inputs})
    expected, found = evaluate(family.jac, drawn), evaluate(staged, drawn)
    assert [(o.port, o.sparsity) for o in staged.outputs] == [(o.port, o.sparsity) for o in family.jac.outputs]
    for name, straight in expected.items():
        np.testing.assert_allclose(found[name], straight, rtol=0, atol=1e-12 * max(1.0, np.abs(straight).max()))


@pytest.mark.parametrize("scalars", [False, True], ids=["vectors", "scalars"])
@pytest.mark.parametrize("name", ["branched", "double_pendulum"])
def test_the_c_of_a_loop_gives_the_jacobian(name: str, scalars: bool, tmp_path: Path) -> None:
    """As the straight C does, alone and with the values; a tree with branches has places that stay zero."""
    found = []
    for limit in (0, 10**9):
        options = replace(OPTIONS, size=CodeSize(straight=limit))
        product = generate(MODELS / f"{name}.yaml", tmp_path / str(limit), options)
        assert ("mbs_columns.h" in product.files) == (limit == 0)
        if scalars and limit == 0:
            header = tmp_path / "0" / "mbs_columns.h"
            header.write_text(f"#define MBS_SCALAR\n{header.read_text()}")
        rng = np.random.default_rng(2)
        inputs = product.manifest.kernel("jac_exp1").inputs
        state: dict[str, Any] = {i.name: rng.uniform(0.3, 1.2, i.nnz) for i in inputs if i.name != "h"}
        kernels = mbsrun.load(tmp_path / str(limit))
        found.append({**kernels.jac("exp1", **state), **kernels.lin("exp1", **state)})
    looped, straight = found
    assert looped.keys() == straight.keys()
    for result, expected in straight.items():
        scale = max(1.0, float(np.abs(expected).max(initial=0.0)))
        np.testing.assert_allclose(looped[result], expected, rtol=0, atol=1e-12 * scale)


@pytest.mark.parametrize("flags", FLAGS)
@pytest.mark.parametrize("name", ["branched", "quadruped"])
def test_lanes_give_the_bits_of_single_states(
    name: str, flags: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Signs of zeros, too, at rest as in motion. Derivatives by forces are LAPACK's inverse of M."""
    monkeypatch.setenv("CFLAGS", f"-O1 {flags}")
    product = generate(MODELS / f"{name}.yaml", tmp_path, replace(OPTIONS, functions=("impl", "exp2")))
    kernels, rng = mbsrun.load(tmp_path), np.random.default_rng(3)
    drawn = {i.name: rng.uniform(0.3, 1.2, (19, i.nnz)) for i in product.manifest.kernel("lin_exp2").inputs}
    state: dict[str, Any] = {x: values for x, values in drawn.items() if x != "h"}
    state["qd"][3:14] = 0
    alone, several = (kernels.batch("lin_exp2", lanes=lanes, **state)[0] for lanes in (False, True))
    assert {x: values.tobytes() for x, values in alone.items()} == {x: v.tobytes() for x, v in several.items()}
    of_impl = kernels.batch("jac_impl", qdd=alone["qdd"], **state)[0]
    expected = -np.linalg.solve(of_impl["jac_Phi_qdd"], of_impl["jac_Phi_u"])
    np.testing.assert_allclose(several["jac_qdd_u"], expected, rtol=0, atol=1e-11 * np.abs(expected).max())


@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_no_compiler_warns_of_a_loop(compiler: str, real: str, tmp_path: Path, requires: Callable[[str], str]) -> None:
    """With sanitizers as well, which the C passes at a state, and at one whose pivots fail."""
    generate(MODELS / "branched.yaml", tmp_path, OPTIONS)
    (tmp_path / "main.c").write_text(PROBE)
    strict = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror")
    options = (*strict, f"-DMBS_REAL={real}", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
    kernels = (tmp_path / f"branched_{name}.c" for name in ("jac_exp1", "setup", "default_parameters"))
    files = [tmp_path / "main.c", *kernels]
    program = tmp_path / "probe"
    subprocess.run([requires(compiler), *options, *files, "-lm", "-o", program], check=True)
    assert subprocess.run([program], check=True, capture_output=True, text=True).stdout.split() == ["0", "1"]


PROBE = """
#include <math.h>
#include <stdio.h>

#include "branched.h"

/* The status at a state, and whether nothing is written at one that is not a number. */
int main(void)
{
    mbs_real q[7] = {0}, qd[7] = {0}, u[5] = {0}, p[9], h[64], r[3][49];
    int i;
    branched_default_parameters(p);
    i = branched_compute_setup(p, h);
    printf("%d ", i + branched_compute_jac_exp1(q, qd, u, h, r[0], r[1], r[2]));
    for (i = 0; i < 7; ++i)
        q[i] = (mbs_real)NAN;
    r[0][0] = 5;
    i = branched_compute_jac_exp1(q, qd, u, h, r[0], r[1], r[2]);
    printf("%d", i != 0 && r[0][0] == 5);
    return 0;
}
"""
