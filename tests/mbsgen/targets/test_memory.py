"""Every kernel under sanitizers, and with poisoned results: all nonzeros are written, and nothing else is touched."""

from __future__ import annotations

import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from mbsgen import manifest
from mbsgen.manifest import Manifest
from mbsgen.pipeline import generate, write_families
from mbsgen.targets.contract import Family
from tests.mbsgen.targets.compilation import Requires, run
from tests.mbsgen.targets.guarded import guarded_tape
from tests.random_trees import random_tree, with_wrenches
from tests.sample import write_sample

ROOT = Path(__file__).parents[3]
PROBE = Path(__file__).parent / "probe.c"
SANITIZERS = {"gcc": "address,undefined", "clang": "memory"}  # the latter finds reads before writes


def build(folder: Path, told: Manifest, target: Path, compiler: str, *flags: str) -> Path:
    """Compile the probe with all kernels of a generated folder."""
    prefix = told.prefix
    listed = " ".join(f'X("{k.name}", {k.symbol})' for k in told.kernels)
    macros = [f'-DMODEL_HEADER="{told.header}"', f"-DPROBED(X)={listed}"]
    if told.parameters:
        functions = {"DEFAULTS": f"{prefix}_default_parameters", "SETUP": f"{prefix}_compute_setup"}
        macros += [f"-DPARAMETERS={prefix}_PARAMETERS", *(f"-D{name}={value}" for name, value in functions.items())]

    def compile_source(source: Path) -> Path:
        made = target.with_name(f"{source.stem}.o")
        run(compiler, "-std=c99", *flags, *macros, f"-I{folder}", "-c", source, "-o", made)
        return made

    with ThreadPoolExecutor(2) as pool:
        objects = list(pool.map(compile_source, [PROBE, *(folder / name for name in told.sources)]))
    run(compiler, *flags, *objects, "-lm", "-o", target)
    return target


@pytest.fixture(scope="module")
def folded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Generate a model of numbers that are folded: results that are literals, zeros that are left out, a sensor."""
    out = tmp_path_factory.mktemp("folded") / "cart_pole"
    generate(ROOT / "models" / "cart_pole.yaml", out)
    return out


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Generate a tree with every input there is but theta: its numbers are parameters, some wrenches are open."""
    tree = with_wrenches(random_tree(0, 2, runtime=True), 5)
    parameters = {p.name: p.value for p in tree.parameters}
    return write_sample(tmp_path_factory.mktemp("opened"), "opened", write_families(tree), parameters)


@pytest.mark.parametrize("compiler", SANITIZERS)
@pytest.mark.parametrize("model", ["folded", "opened"])
def test_kernels_write_all_nonzeros_and_nothing_else(
    model: str, compiler: str, request: pytest.FixtureRequest, tmp_path: Path, requires: Requires
) -> None:
    folder: Path = request.getfixturevalue(model)
    told = manifest.read(folder / manifest.FILE_NAME)
    flags = ("-O0", f"-fsanitize={SANITIZERS[compiler]}", "-fno-sanitize-recover=all")
    program = build(folder, told, tmp_path / "probe", requires(compiler), *flags)
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, ""), done.stdout[-500:]
    found = {name: (int(calls), int(failed)) for name, calls, failed in map(str.split, done.stdout.splitlines())}
    assert found.keys() == {k.name for k in told.kernels}
    assert all(calls >= 3 and not failed for calls, failed in found.values())


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("    f[1] = ", "    if (!f) f[1] = "),  # one that is not written
        ("    return 0;", "    return 3;"),  # results, although it fails
        ("    f[1] = ", "    ((mbs_real *)x)[0] = f[1] = "),  # an input
        ("    if (!g)\n        g = &mbs_unwanted[3];\n", ""),  # what is not wanted
    ],
    ids=["left out", "failed", "input", "unwanted"],
)
def test_the_probe_finds_what_it_looks_for(before: str, after: str, tmp_path: Path, requires: Requires) -> None:
    folder = write_sample(tmp_path / "sample")
    source = folder / "sample_impl.c"
    assert before in source.read_text()
    source.write_text(source.read_text().replace(before, after, 1))
    program = build(folder, manifest.read(folder / manifest.FILE_NAME), tmp_path / "probe", requires("gcc"), "-O0")
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert not done.stdout or done.stdout.splitlines()[-1] == "impl: written or left what should not be"


def test_a_kernel_that_fails_writes_nothing(tmp_path: Path, requires: Requires) -> None:
    """Of random states, some fail at a pivot that is not positive."""
    folder = write_sample(tmp_path / "sample", families=(Family(guarded_tape()),))
    program = build(folder, manifest.read(folder / manifest.FILE_NAME), tmp_path / "probe", requires("gcc"), "-O0")
    _, calls, failed = run(program).split()
    assert 0 < int(failed) < int(calls)
