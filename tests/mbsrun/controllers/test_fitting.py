"""A controller of steps alone: it needs no solve, a fraction of the memory, and fits a small microcontroller."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from mbsgen.targets.layout import lay_out
from mbsrun import bare
from mbsrun.controllers.making import Made, make
from mbsrun.external import load_on_demand
from mbsrun.library import find_compiler
from mbsrun.ocp.statement.statement import read_problem

MODEL = """\
name: pendulum
gravity: [0, 0, -9.81]
bodies:
  - {name: rod, joint: {name: q, type: revolute, axis: y}, mass: 1, com: [0, 0, -0.5]}
"""
PROBLEM = """\
model: pendulum.yaml
horizon: 1
intervals: 10
scheme: radau
degree: 1
cost: {inputs: 0.01, running: [{expression: 1 + cos(q_q), weight: 10}, {expression: qd_q**2, weight: 0.1}]}
start: {pose: {q: 3}}
bounds: {inputs: [-5, 5]}
guess: {motion: rest}
"""
ALONE = "-DMBS_STAGES_REALTIME"
MEMORY, CODE = 24 * 1024, 48 * 1024


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, requires: Callable[[str], str]) -> tuple[Made, Path]:
    requires("cc")
    place = tmp_path_factory.mktemp("fitting")
    (place / "pendulum.yaml").write_text(MODEL, encoding="utf-8")
    (place / "swing.ocp.yaml").write_text(PROBLEM, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CFLAGS", "-O0")
        made = make(*read_problem(place / "swing.ocp.yaml", load_on_demand), place / "pendulum.yaml")
    for name, text in made.files.items():
        (place / name).write_text(text, encoding="utf-8")
    return made, place


@dataclass(frozen=True)
class Objects:
    """The C files of the folder as objects, and the command that compiled them."""

    command: tuple[str, ...]
    files: tuple[Path, ...]


@pytest.fixture(scope="module", params=[[], ["-DMBS_STAGES_FLOAT"]], ids=["double", "single"])
def objects(
    made: tuple[Made, Path], request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Objects:
    """Compile the folder under sanitizers, without a warning, once for both programs."""
    out, (manifest, place) = tmp_path_factory.mktemp("objects"), (made[0].manifest, made[1])
    flags = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fsanitize=address,undefined"]
    command = (*find_compiler(os.environ).command, *flags, *request.param, ALONE, f"-I{place}")
    subprocess.run([*command, "-c", *(place / source for source in manifest.sources)], check=True, cwd=out)
    return Objects(command, tuple(out / Path(source).with_suffix(".o").name for source in manifest.sources))


@pytest.mark.parametrize("program", ["check", "main"])
def test_steps_alone_stay_at_the_stored_optimum(
    made: tuple[Made, Path], objects: Objects, tmp_path: Path, program: str
) -> None:
    """The folder's own programs end well under sanitizers, without a warning: there is no solve to call."""
    source = made[1] / f"{made[0].manifest.prefix}_{program}.c"
    subprocess.run([*objects.command, source, *objects.files, "-lm", "-o", tmp_path / "program"], check=True)
    subprocess.run([tmp_path / "program"], check=True)


def test_a_pendulum_fits_in_24_and_48_kilobytes(
    made: tuple[Made, Path], tmp_path: Path, requires: Callable[[str], str]
) -> None:
    """Memory, and code with constants and C library; ten periods make a step, with the inputs of the whole solver."""
    for tool in bare.PACKAGES:
        requires(tool)
    manifest, place = made[0].manifest, made[1]
    parts = {"name": manifest.prefix, "predicts": manifest.predicts, "bytes": manifest.memory.single, "periods": 10}
    (tmp_path / "main.c").write_text(lay_out("controller/bare.c", **parts), encoding="utf-8")
    sources, found = [tmp_path / "main.c", *(place / source for source in manifest.sources)], []
    for flags in ([], ["-Os", "-DMBS_LIBM", ALONE]):
        image = bare.build(sources, tmp_path / "image.elf", ["-DMBS_STAGES_FLOAT", *flags, f"-I{place}"])
        outcome = bare.run(image.path)
        assert outcome.status == 0
        found.append((outcome.numbers("bytes")[0], image.code, outcome.numbers("input"), outcome.numbers("step")))
    (most, _, expected, _), (memory, code, inputs, steps) = found
    assert memory <= MEMORY
    assert memory < most / 2
    assert code <= CODE
    assert len(set(steps)) == 1
    assert inputs == pytest.approx(expected, abs=2e-3)
