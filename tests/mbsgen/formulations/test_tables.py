"""M by loops over tables: Pinocchio's, and the straight code's, for any tree, in C."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mbsrun
from mbsgen.formulations.catalogue import FUNCTIONS
from mbsgen.formulations.reductions import ALL
from mbsgen.formulations.tables import write_semi
from mbsgen.model.changes.scene import Scene
from mbsgen.pipeline import Options, generate
from mbsgen.procedure.procedure import evaluate
from mbsgen.request import MEASURED
from tests.mbsgen.derivatives.evaluation import matrix
from tests.random_trees import Pinocchio, floating, random_tree, with_laws, with_rotors, with_wrenches

BRANCHED = Path(__file__).parents[3] / "models" / "branched.yaml"
TABLES = replace(MEASURED, matrix=0)
OPTIONS = Options(functions=("semi",), derivatives=0, size=TABLES)
TREES = {
    "all forces": with_wrenches(with_laws(with_rotors(random_tree(5, 7), 5)), 5),
    "run time": with_laws(random_tree(7, 4, runtime=True)),
    "floating": floating(random_tree(2, 3)),
}


@pytest.mark.parametrize("name", TREES)
def test_tables_give_what_straight_code_gives(name: str) -> None:
    """M and c, to rounding; where straight code knows a zero, M is zero."""
    tree, rng = TREES[name], np.random.default_rng(4)
    by_tables, straight = write_semi(tree, ALL), FUNCTIONS["semi"].build(tree, ALL)
    drawn = {wire.name: list(rng.uniform(0.3, 1.2, wire.sparsity.nnz)) for wire in by_tables.inputs}
    found, expected = evaluate(by_tables, drawn), evaluate(straight, drawn)
    for output in straight.outputs:
        own, other = matrix(by_tables, output.name, found), matrix(straight, output.name, expected)
        np.testing.assert_allclose(own, other, rtol=0, atol=1e-13 * max(1.0, np.abs(other).max()))


def test_tables_give_pinocchios_matrix() -> None:
    """With rotors, by `crba`; c is `rnea` without accelerations."""
    tree, rng = with_rotors(random_tree(3, 8), 3), np.random.default_rng(5)
    q, qd = rng.uniform(-1.5, 1.5, (2, 8))
    peer, by_tables = Pinocchio(tree), write_semi(tree, ALL)
    found = evaluate(by_tables, {"q": list(q), "qd": list(qd)})
    for name, expected in (("M", peer.mass_matrix(q)), ("c", peer.residual(q, qd, np.zeros(8))[:, None])):
        own = matrix(by_tables, name, found)
        np.testing.assert_allclose(own, expected, rtol=0, atol=1e-13 * max(1.0, np.abs(expected).max()))


@pytest.mark.parametrize("kind", ["lanes", "one by one"])
def test_the_c_of_tables_gives_the_matrix(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the straight C does, with parameters at run time, of one state and of many."""
    monkeypatch.setenv("CFLAGS", "-O1")
    found = []
    for size in (TABLES, MEASURED):
        folder = tmp_path / str(size.matrix)
        product = generate(BRANCHED, folder, replace(OPTIONS, size=size))
        assert ("mbs_matrix.h" in product.files) == (size is TABLES)
        assert ("SEMI" in product.report.formulations) == (size is MEASURED)
        rng = np.random.default_rng(2)
        inputs = product.manifest.kernel("semi").inputs
        states = {i.name: rng.uniform(0.3, 1.2, (40, i.nnz)) for i in inputs if i.name != "h"}
        kernels = mbsrun.load(folder)
        many, status = kernels.batch("semi", lanes=kind == "lanes", **states)
        assert not status.any()
        found.append(
            {**many, **{f"one {x}": y for x, y in kernels.semi(**{n: x[0] for n, x in states.items()}).items()}}
        )
    by_tables, straight = found
    assert by_tables.keys() == straight.keys()
    for result, expected in straight.items():
        atol = 1e-13 * max(1.0, float(np.abs(expected).max()))
        np.testing.assert_allclose(by_tables[result], expected, rtol=0, atol=atol)


def test_joined_functions_and_other_languages_stay_straight(tmp_path: Path) -> None:
    """Loops over tables cannot be joined with other functions, and stand in C alone."""
    product = generate(BRANCHED, tmp_path / "wasm", replace(OPTIONS, targets=("python",)))
    assert "mbs_matrix.h" not in product.files
    scene = Scene(together=(("both", ("semi", "energy")),))
    joined = generate(BRANCHED, tmp_path / "joined", replace(OPTIONS, functions=None, scene=scene))
    assert "mbs_matrix.h" not in joined.files


@pytest.mark.parametrize(("compiler", "real"), [("gcc", "float"), ("clang", "double")])
def test_no_compiler_warns_of_tables(compiler: str, real: str, tmp_path: Path, requires: Callable[[str], str]) -> None:
    """With sanitizers as well."""
    generate(BRANCHED, tmp_path, OPTIONS)
    (tmp_path / "main.c").write_text(PROBE)
    strict = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror")
    options = (*strict, f"-DMBS_REAL={real}", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
    files = [
        tmp_path / "main.c",
        *(tmp_path / f"branched_{name}.c" for name in ("semi", "setup", "default_parameters")),
    ]
    program = tmp_path / "probe"
    subprocess.run([requires(compiler), *options, *files, "-lm", "-o", program], check=True)
    assert subprocess.run([program], check=True, capture_output=True, text=True).stdout == "0"


PROBE = """
#include <stdio.h>

#include "branched.h"

int main(void)
{
    mbs_real q[7] = {0}, qd[7] = {0}, p[9], h[99], M[49], c[7];
    int i;
    branched_default_parameters(p);
    i = branched_compute_setup(p, h);
    printf("%d", i | branched_compute_semi(q, qd, h, M, c));
    return 0;
}
"""
