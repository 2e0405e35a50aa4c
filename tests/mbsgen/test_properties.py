"""Laws for any model and any scene: reductions change no result, and C does as many operations as the report counts."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from mbsgen.errors import InputError
from mbsgen.evidence import gather
from mbsgen.formulations.reductions import Reductions
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.changes.scene import stage
from mbsgen.pipeline import make
from mbsgen.request import Options, merge
from tests.fuzz import mechanisms
from tests.mbsgen.model.files import reread
from tests.random_scenes import random_model, random_scene

ONE_PLAN = Reductions(trials=1)
ROUNDING = 1e-12  # of some hundred products of numbers near 1, in other frames; relative to the largest result


@pytest.mark.parametrize("seed", [1, 2, 3, 5])
def test_what_a_scene_leaves_agrees_with_the_whole(seed: int) -> None:
    """Reduced functions at random states, against the whole model's."""
    model = random_model(seed, 3 + seed % 3)
    scene = random_scene(model, seed)
    evidence = gather(model, merge(Options(reductions=ONE_PLAN), scene))
    assert scene.functions is not None
    assert set(evidence.deviations) == set(scene.functions)
    assert max(evidence.deviations.values()) < ROUNDING, evidence.deviations


@pytest.mark.parametrize("seed", range(10))
def test_models_are_read_as_they_were_and_what_scenes_leave_too(seed: int) -> None:
    """The same model; of places that locking has computed, the same numbers."""
    model = random_model(seed, 6)
    assert reread(model) == model
    left = stage(model, random_scene(model, seed))
    assert build_tree(reread(left)) == build_tree(left)


@pytest.mark.parametrize("first", range(0, 30, 10))
def test_any_file_is_read_as_it_is_written_again(first: int, tmp_path: Path) -> None:
    """A model file of any joints, couplings, laws and functions of parameters, written and read, is the same model."""
    accepted = 0
    for seed in range(first, first + 10):
        try:
            model = mechanisms.read(mechanisms.draw(seed), tmp_path)
        except InputError:
            continue  # a mechanism that cannot move
        assert reread(model) == model, seed
        accepted += 1
    assert accepted >= 5


@pytest.mark.parametrize("seed", [2])
def test_flops_are_those_of_the_c(seed: int) -> None:
    """The report's figures, and the manifest's, against the operations in the C files, read as expressions."""
    model = random_model(seed, 2)
    scene = random_scene(model, seed)
    product = make(model, Options(scene=scene, derivatives=1, reductions=ONE_PLAN))
    for kernel in product.manifest.kernels:
        found = count_operations("".join(product.files[source] for source in kernel.sources), kernel.function)
        assert found == kernel.flops.paper + kernel.flops.other, kernel.name


def count_operations(text: str, function: str) -> int:
    """Count operations in the body of a C function; sines and cosines where they are used."""
    start = text.rindex(f"int {function}(")  # before it come plain names, which call the function
    inner = text[start : text.index("\n}\n", start)]
    rights = re.findall(r"^ +(?:const mbs_real )?\w+(?:\[\d+\])? = ([^;{&]+);$", inner, re.MULTILINE)
    angles = re.findall(r"mbs_angles\d+\[[^=]*\] = \{([^}]*)\};", inner)
    plain = re.compile(r"MBS_C\(-?([^()]*)\)")  # a literal's sign is part of it
    return sum(_count(plain.sub(r"\1", " ".join(right.split()))) for right in (*rights, *(f"[{x}]" for x in angles)))


def _count(expression: str) -> int:
    nodes = [*ast.walk(ast.parse(expression, mode="eval"))]
    angles = [node for node in nodes if isinstance(node, ast.Name) and re.match("mbs_(sines|cosines)", node.id)]
    return len(angles) + sum(isinstance(node, ast.BinOp | ast.UnaryOp | ast.Call) for node in nodes)
