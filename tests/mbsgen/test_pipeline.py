"""Generation as a whole: the same bytes anywhere, the same numbers with run-time parameters, folders whole or not."""

from __future__ import annotations

import hashlib
import os
import re
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen import manifest
from mbsgen.errors import InputError
from mbsgen.model.reader import read_model
from mbsgen.model.tree import Kind, Tree
from mbsgen.pipeline import (
    OptionError,
    Options,
    build_parametric,
    generate,
    make,
    read_tree,
    write_families,
    write_folder,
)
from mbsgen.tape.interpreter import evaluate
from mbsgen.tape.types import Tape
from tests.random_trees import random_tree
from tests.reference_models import BRANCHED

ROOT = Path(__file__).parents[2]
ALL = Options(runtime=True, targets=("python", "matlab"))
GENERATE = """
import pathlib, sys
from mbsgen.pipeline import OptionError, Options, generate
generate(pathlib.Path("model.yaml"), pathlib.Path(sys.argv[1]), Options(targets=("python", "matlab")))
"""
WITHOUT_NUMPY = """
import pathlib, sys
sys.modules["numpy"] = None
from mbsgen.pipeline import Options, generate
options = Options(functions=("impl", "exp2"), derivatives=0, targets=("wasm",))
generate(pathlib.Path("model.yaml"), pathlib.Path(sys.argv[1]), options)
"""
Array = NDArray[np.float64]


@pytest.fixture
def model(tmp_path: Path) -> Path:
    file = tmp_path / "model.yaml"
    file.write_text(BRANCHED, encoding="utf-8")
    return file


def read_folder(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def test_the_same_bytes_under_any_hash_seed(model: Path) -> None:
    """Of a model with constant and with run-time parameters, in every target."""
    folders = []
    for seed in ("0", "4242"):
        out = model.parent / seed
        command = [sys.executable, "-c", GENERATE, out.name]
        environment = {**os.environ, "PYTHONHASHSEED": seed}
        subprocess.run(command, cwd=model.parent, env=environment, check=True)
        folders.append(read_folder(out))
    assert folders[0] == folders[1]
    assert {Path(name).suffix for name in folders[0]} >= {".c", ".h", ".py", ".m", ".json", ".md"}


def test_a_tree_is_generated_without_numpy(model: Path) -> None:
    """Browsers run the generator without it; the bytes are the same."""
    without, inside = model.parent / "without", model.parent / "inside"
    subprocess.run([sys.executable, "-c", WITHOUT_NUMPY, str(without)], cwd=model.parent, check=True)
    generate(model, inside, Options(functions=("impl", "exp2"), derivatives=0, targets=("wasm",)))
    assert read_folder(without) == read_folder(inside)


def test_no_file_tells_where_or_when_it_was_made(model: Path) -> None:
    for name, text in make(model, ALL).files.items():
        assert not Path(name).is_absolute()
        for place in (str(model.parent), str(ROOT), str(Path.home()), model.name):
            assert place not in text, name
        assert not re.search(r"\b(19|20)\d\d-\d\d-\d\d\b|\b\d\d:\d\d:\d\d\b", text), name


def test_the_hash_names_what_is_generated(model: Path) -> None:
    """A comment or the order of keys change nothing; a number's last digit, a name, and an option do.

    What the model says is named by itself: that is the same with other options, and where a default is spelt out.
    """

    def hash_of(text: str, *, runtime: bool = False) -> tuple[str, str]:
        model.write_text(text, encoding="utf-8")
        made = make(model, Options(functions=("impl",), derivatives=0, runtime=runtime)).manifest
        return made.model_hash, made.mechanism

    plain = hash_of(BRANCHED)
    assert hash_of("# a comment\n" + BRANCHED) == plain
    others = [
        hash_of(BRANCHED.replace("mass: 0.7\n", "mass: 0.7000000000000001\n")),
        hash_of(BRANCHED.replace("name: branched", "name: other")),
        hash_of(BRANCHED.replace("{value: 1.5,", "{value: 1.25,")),
    ]
    option = hash_of(BRANCHED, runtime=True)
    assert len({code for code, _ in (plain, option, *others)}) == 2 + len(others)
    assert len({mechanism for _, mechanism in (plain, *others)}) == 1 + len(others)
    assert option[1] == plain[1]
    assert hash_of(BRANCHED.replace("name: trunk\n", "name: trunk\n    parent: base\n", 1)) == plain


@pytest.mark.parametrize("case", ["arm", "branched", "random"])
def test_parameters_at_run_time_give_the_numbers_of_constants(case: str, model: Path) -> None:
    """Every kernel: setup's results in, the same values out, to 1e-12 of the largest.

    Except `condition.articulated`, which depends on the operations of EXP2: other operations when parameters vary.
    """
    if case == "random":
        constant, runtime = (evaluated(random_tree(5, 3, runtime=choice)) for choice in (False, True))
    else:
        description = read_model(model if case == "branched" else ROOT / "models" / "arm_pendulum.yaml")
        constant, runtime = evaluated(read_tree(description)), evaluated(build_parametric(description))
    assert next(iter(runtime)) == "setup"
    for kernel, results in constant.items():
        if kernel == "setup":
            continue
        for name, expected in results.items():
            if name == "articulated":
                continue
            scale = max(1.0, np.abs(expected).max(initial=0))
            assert np.abs(runtime[kernel][name] - expected).max(initial=0) <= 1e-12 * scale, f"{kernel}.{name}"


def evaluated(tree: Tree) -> dict[str, dict[str, Array]]:
    """Evaluate every kernel at inputs that depend on their names alone, as full matrices."""
    families = write_families(tree)
    own = {"p": [p.value for p in tree.parameters if p.kind is Kind.RUNTIME]}
    if own["p"]:
        assert families[0].value.name == "setup"
        own |= evaluate(families[0].value, own)
    return {tape.name: full(tape, evaluate(tape, draw(tape, own))) for family in families for tape in family.tapes}


def draw(tape: Tape, own: Mapping[str, Sequence[float]]) -> dict[str, Sequence[float]]:
    at = {}
    for i in tape.inputs:
        seed = int.from_bytes(hashlib.sha256(i.name.encode()).digest()[:4], "big")
        at[i.name] = own.get(i.name) or np.random.default_rng(seed).uniform(-1, 1, i.sparsity.nnz).tolist()
    return at


def full(tape: Tape, values: Mapping[str, Sequence[float]]) -> dict[str, Array]:
    matrices = {}
    for o in tape.outputs:
        matrices[o.name] = np.zeros((o.sparsity.rows, o.sparsity.cols))
        for (r, c), value in zip(o.sparsity.entries, values[o.name], strict=True):
            matrices[o.name][r, c] = value
    return matrices


def test_setup_is_generated_only_where_there_is_something_to_set_up(model: Path) -> None:
    """Run-time parameters of the file are the manifest's, in its order; --runtime adds the rest."""
    some, all_ = make(model).manifest, make(model, Options(runtime=True)).manifest
    assert [(p.name, p.value) for p in some.parameters] == [("mass", 1.5)]
    assert {"length", "mass", "right.mass", "right.com.z", "gravity.y"} <= {p.name for p in all_.parameters}
    model.write_text(BRANCHED.replace("{value: 1.5, kind: runtime}", "1.5"))
    none = make(model).manifest
    assert (none.parameters, [k.name for k in none.kernels if k.name == "setup"]) == ((), [])
    assert all(i.name != "h" for k in none.kernels for i in k.inputs)


def test_a_folder_is_replaced_as_a_whole(model: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    generate(model, out, ALL)
    assert (out / "branched.py").is_file()
    product = generate(model, out)
    assert read_folder(out) == {name: text.encode() for name, text in product.files.items()}
    assert manifest.read(out / manifest.FILE_NAME) == product.manifest


def test_a_write_that_fails_leaves_what_was_there(model: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    generate(model, out)
    before = read_folder(tmp_path)
    with pytest.raises(InputError, match="cannot be written"):
        write_folder({"good.c": "", "n" * 300: ""}, out)
    with pytest.raises(InputError, match="cannot be written"):
        write_folder({"good.c": "", "n" * 300: ""}, tmp_path / "new")
    assert read_folder(tmp_path) == before
    assert sorted(tmp_path.iterdir()) == [model, out]


@pytest.mark.parametrize("text", ["", "{", "[]", "null", '{"generator": "another 1.0"}', "[" * 100_000, "\xff"])
def test_a_folder_with_another_manifest_is_left_alone(text: str, model: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / manifest.FILE_NAME).write_text(text, encoding="latin-1")
    before = read_folder(tmp_path)
    with pytest.raises(InputError, match="no folder that mbsgen wrote"):
        generate(model, out)
    assert read_folder(tmp_path) == before


def kernels(model: Path, **options: object) -> list[str]:
    return [kernel.name for kernel in make(model, Options(**options)).manifest.kernels]


def test_only_chosen_functions_are_generated(model: Path) -> None:
    """With their derivatives, in the catalogue's order, and with the setup that they need; no other than among all."""
    names = kernels(model, functions=("frames", "exp1"))
    family = ["exp1", "jac_exp1", "adj1_exp1", "jac_adj1_exp1", "lin_exp1"]
    assert names == ["setup", *family, "frames"]
    model.write_text(BRANCHED.replace("{value: 1.5, kind: runtime}", "1.5"))
    some, all_ = make(model, Options(functions=("sensors",))), make(model)
    for kernel in some.manifest.kernels:
        assert kernel == all_.manifest.kernel(kernel.name)


@pytest.mark.parametrize(
    ("order", "prefixes"),
    [(0, {""}), (1, {"", "jac_", "adj1_", "lin_"}), (2, {"", "jac_", "adj1_", "jac_adj1_", "lin_"})],
)
def test_derivatives_are_generated_up_to_an_order(order: int, prefixes: set[str], model: Path) -> None:
    names = kernels(model, functions=("impl", "sensors", "exp2"), derivatives=order)
    assert set(names) - {"setup"} == {*(p + f for p in prefixes for f in ("impl", "sensors", "exp2"))}


def test_derivatives_of_single_functions_are_left_out(model: Path) -> None:
    names = kernels(model, functions=("impl", "exp1"), derivatives=1, values=("exp1",))
    assert names == ["setup", "impl", "jac_impl", "adj1_impl", "lin_impl", "exp1"]
    with pytest.raises(OptionError, match=r"^values: exp2 is not among the functions"):
        make(model, Options(functions=("impl", "exp1"), values=("exp2",)))


@pytest.mark.parametrize("functions", [("frames",), ("impl", "semi"), ("sensors", "frames")])
@pytest.mark.parametrize("order", [0, 1])
def test_a_part_passes_its_own_check(
    functions: tuple[str, ...], order: int, model: Path, tmp_path: Path, requires: Callable[[str], str]
) -> None:
    """The check program compares what there is."""
    out = tmp_path / "out"
    generate(model, out, Options(functions=functions, derivatives=order))
    subprocess.run(
        [requires("cc"), "-O1", f"-I{out}", *map(str, out.glob("*.c")), "-lm", "-o", str(out / "check")], check=True
    )
    assert subprocess.run([out / "check"], check=False).returncode == 0


def test_functions_that_there_are_not_are_told_at_once(model: Path) -> None:
    model.write_text(BRANCHED.partition("frames:")[0])
    with pytest.raises(OptionError) as told:
        make(model, Options(functions=("imlp", "motion", "xyz", "impl")))
    known = "impl, semi, semi_res, exp1, exp2, reactions, regressor, condition, energy, power, frames"
    assert str(told.value).splitlines() == [
        "functions: there is no function 'imlp'; is impl meant?",
        "functions: motion is of sensors, and branched has none; name some under `frames:`",
        f"functions: there is no function 'xyz'; there are {known}",
    ]
    with pytest.raises(OptionError, match=f"no function is named; there are {known}"):
        make(model, Options(functions=()))


def test_a_model_made_in_python_is_generated_like_its_file(model: Path, tmp_path: Path) -> None:
    made = read_model(model)
    product = generate(made, tmp_path / "out", Options(functions=("impl",)))
    assert product.files == make(model, Options(functions=("impl",))).files
    assert read_folder(tmp_path / "out") == {name: text.encode() for name, text in product.files.items()}


def test_each_stage_is_told_when_it_begins(tmp_path: Path) -> None:
    path = tmp_path / "branched.yaml"
    path.write_text(BRANCHED, encoding="utf-8")
    stages: list[str] = []
    make(path, Options(functions=("impl", "frames"), derivatives=1), stages.append)
    assert stages == [
        "reading the model",
        "impl",
        "impl and its derivatives",
        "frames",
        "the check of all functions",
        "C",
        "the report",
    ]
