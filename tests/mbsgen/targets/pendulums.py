"""Folders of C of pendulums of some mass, callers of one, and their objects."""

from __future__ import annotations

import math
from pathlib import Path

from mbsgen.pipeline import Options, generate
from tests.mbsgen.targets.programs import run

CC = ("cc", "-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-O0")
MODEL = """\
name: {name}
parameters:
  m: {mass}
  k: {{value: 3, kind: runtime}}
gravity: [0, 0, -10]
bodies:
  - name: rod
    joint: {{name: q, type: revolute, axis: y}}
    mass: m
    com: [0, 0, -k]
"""
LIGHT, HEAVY = 2.0, 18.0  # kg
WANTED = 10 * 3 * math.sin(0.5)  # the torque of gravity for 1 kg at rest at 0.5 rad

# A function in a separate file, which sees one folder's header.
UNIT = """\
#include "{folder}/{prefix}.h"
double {function}(void);
double {function}(void)
{{
    const mbs_real q[1] = {{0.5}}, rest[1] = {{0}};
    mbs_real p[{prefix}_PARAMETERS], h[{prefix}_setup_NNZ_h], Phi[1] = {{0}};
    {prefix}_default_parameters(p);
    {prefix}_compute_setup(p, h);
    {call}
    return Phi[0] + 0 * {prefix}_NAMES_q[0][0];
}}
"""
TYPED = "{prefix}_compute_impl(q, rest, rest, rest, h, Phi);"
CASADI = """\
const mbs_real *arg[] = {{q, rest, rest, rest, h}};
    mbs_real *res[] = {{Phi}};
    {prefix}_impl(arg, res, 0, 0, 0);"""


def write(place: Path, folder: str, mass: float, name: str = "arm", prefix: str | None = None) -> Path:
    """Generate the residual of a pendulum of some mass in a folder."""
    model = place / f"{folder}.yaml"
    model.write_text(MODEL.format(name=name, mass=mass))
    generate(
        model, place / folder, Options(functions=("impl",), derivatives=0, count=False, targets=("cpp",), prefix=prefix)
    )
    return place / folder


def write_unit(place: Path, folder: str, function: str, call: str = TYPED, prefix: str = "arm") -> Path:
    """Write a C file that computes the torque by one folder's header."""
    out = place / f"use_{function}.c"
    text = call.format(prefix=prefix)
    out.write_text(UNIT.format(folder=folder, prefix=prefix, function=function, call=text))
    return out


def list_sources(folder: Path) -> list[Path]:
    """List all C files of a folder, its programs among them."""
    return sorted(folder.glob("*.c"))


def compile_folder(folder: Path, out: Path, *flags: str) -> list[Path]:
    """Compile each C file of a folder to an object."""
    out.mkdir()
    objects = [out / f"{source.stem}.o" for source in list_sources(folder)]
    for source, target in zip(list_sources(folder), objects, strict=True):
        done = run(*CC, *flags, "-c", source, "-o", target, cwd=folder)
        assert done.returncode == 0, done.stderr
    return objects
