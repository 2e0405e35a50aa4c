"""Larger trees: derivatives of accelerations that are written once for both forms, and not at all where a loop is."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mbsgen import pipeline
from mbsgen.derivatives.dynamics import Dynamics
from mbsgen.formulations.catalogue import FUNCTIONS
from mbsgen.formulations.reductions import Reductions
from mbsgen.pipeline import Options, Product, make
from mbsgen.request import CodeSize
from mbsgen.tape.interpreter import evaluate
from mbsgen.tape.types import Tape
from tests.random_trees import random_tree

MODELS = Path(__file__).parents[3] / "models"
ONE_PLAN = Reductions(trials=1)
LARGE = CodeSize(compared=0)  # every tree is a large one
LOOPED = CodeSize(compared=0, straight=0)
STAGED = CodeSize(compared=0, straight=0, certain=0)


def list_guards(tape: Tape) -> list[tuple[int, float]]:
    return [(guard.joint, guard.tolerance) for guard in tape.guards]


def test_the_second_form_has_the_derivatives_it_would_have_alone() -> None:
    """The same values and guards: both eliminate in M, however content EXP2 itself is with small pivots."""
    tree = random_tree(5, 4)
    first, second = (FUNCTIONS[name].build(tree, ONE_PLAN) for name in ("exp1", "exp2"))
    both = Dynamics(tree, ONE_PLAN, size=LARGE)
    shared = both.differentiate(second, [both.differentiate(first)])
    alone = Dynamics(tree, ONE_PLAN, size=LARGE).differentiate(second)
    rng = np.random.default_rng(1)
    for found, expected in ((getattr(x, kind) for x in (shared, alone)) for kind in ("jac", "lin", "adj1")):
        assert found.name == expected.name
        assert found.inputs == expected.inputs
        assert [(o.name, o.sparsity) for o in found.outputs] == [(o.name, o.sparsity) for o in expected.outputs]
        assert list_guards(found) == list_guards(expected)
        drawn = {i.name: list(rng.uniform(0.3, 1.2, i.sparsity.nnz)) for i in found.inputs}
        results, wanted = evaluate(found, drawn), evaluate(expected, drawn)
        for name, values in wanted.items():
            np.testing.assert_allclose(results[name], values, rtol=1e-10, atol=1e-10)
    assert list_guards(shared.jac) == list_guards(first) != list_guards(second)


def test_what_has_a_loop_for_sure_is_not_written_straight() -> None:
    """The C is the same, except for its hash, and so are the manifest's entries."""
    options = Options(functions=("exp1", "exp2"), derivatives=1, reductions=ONE_PLAN, size=LOOPED)
    straight = make(MODELS / "double_pendulum.yaml", options)
    staged = make(MODELS / "double_pendulum.yaml", replace(options, size=STAGED))
    assert straight.manifest.model_hash != staged.manifest.model_hash
    for file in straight.files:
        if not file.startswith("report"):
            assert _hide_hashes(staged, file) == _hide_hashes(straight, file), file


def _hide_hashes(made: Product, file: str) -> str:
    """Return a file without the hash of its model, and without the tag of its symbols that follows from it."""
    tag = re.search(r"_TAG 0x(\w+)", made.files["double_pendulum.h"])
    assert tag is not None
    return made.files[file].replace(made.manifest.model_hash, "").replace(tag[1], "")


def test_stages_take_what_setup_gives() -> None:
    """With parameters at run time, stages are all that `setup` is made for."""
    options = Options(functions=("exp1",), derivatives=1, reductions=ONE_PLAN, size=STAGED)
    kernels = make(MODELS / "branched.yaml", options).manifest
    (given,) = kernels.kernel("setup").outputs
    for name in ("exp1", "jac_exp1", "lin_exp1"):
        assert given.rows in [i.rows for i in kernels.kernel(name).inputs if i.name == given.name], name


@pytest.mark.parametrize("wish", ["python", "matlab", "acados"])
def test_whoever_needs_the_straight_form_gets_it(wish: str, monkeypatch: pytest.MonkeyPatch) -> None:
    options = Options(functions=("exp1",), derivatives=1, reductions=ONE_PLAN, targets=(wish,), size=STAGED)
    found = make(MODELS / "double_pendulum.yaml", options)
    monkeypatch.setattr(pipeline, "_needs_stages_alone", lambda *_: False)
    assert make(MODELS / "double_pendulum.yaml", options).files == found.files
