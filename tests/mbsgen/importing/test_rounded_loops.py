"""Loops of SDF and MJCF from rounded numbers: freedoms, accelerations, and the choice by `--loop-tolerance`.

The planar mechanisms without any tilt are the reference: a small tilt changes accelerations by its own order.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from mbsgen.assembly import assemble
from mbsgen.cli import main
from mbsgen.formulations.catalogue import FUNCTIONS
from mbsgen.formulations.reductions import ALL
from mbsgen.importing import import_model
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.tree import Closure
from mbsgen.procedure.procedure import straight
from mbsgen.tape.interpreter import evaluate

MOMENTS = "<ixx>0.001</ixx><iyy>0.02</iyy><izz>0.02</izz>"


def four_bar(folder: Path, tilt: float) -> Path:
    """Write a planar four-bar in SDF, whose rocker's hinge is off by a tilt; places have all digits."""
    crank, coupler = 0.2, 0.45
    a, b = -0.8, 0.1
    places = {"ground": (0.0, 0.0, 0.0), "crank": (0.0, 0.0, a)}
    places["coupler"] = (crank * np.cos(a), -crank * np.sin(a), b)
    knee = np.array(places["coupler"][:2]) + coupler * np.array([np.cos(b), -np.sin(b)])
    way = knee - [0.5, 0.0]
    places["rocker"] = (0.5, 0.0, float(np.arctan2(-way[1], way[0])))
    links = "".join(
        f'<link name="{name}"><pose>{x!r} 0 {z!r} 0 {pitch!r} 0</pose><inertial><pose>0.1 0 0 0 0 0</pose>'
        f"<mass>1</mass><inertia>{MOMENTS}</inertia></inertial></link>"
        for name, (x, z, pitch) in {k: tuple(map(float, v)) for k, v in places.items()}.items()
    )
    joints = "".join(
        f'<joint name="{name}" type="revolute"><parent>{parent}</parent><child>{child}</child>'
        f"<pose>{x!r} 0 0 0 0 0</pose><axis><xyz>{axis}</xyz></axis></joint>"
        for name, parent, child, x, axis in (
            ("j1", "ground", "crank", 0.0, "0 1 0"),
            ("j2", "crank", "coupler", 0.0, "0 1 0"),
            ("j3", "ground", "rocker", 0.0, f"{tilt} 1 0"),
            ("j4", "coupler", "rocker", float(np.hypot(*way)), "0 1 0"),
        )
    )
    path = folder / "four.sdf"
    fixed = '<joint name="fix" type="fixed"><parent>world</parent><child>ground</child></joint>'
    path.write_text(f'<sdf version="1.9"><model name="four">{links}{fixed}{joints}</model></sdf>')
    return path


def five_bar(folder: Path, tilt: float) -> Path:
    """Write a planar five-bar in MJCF, one of whose bodies is tilted."""
    moments = 'diaginertia="4e-6 3e-6 2e-6"'
    path = folder / "five.xml"
    path.write_text(
        f"""<mujoco model="five"><default><joint axis="1 0 0"/></default><worldbody>
        <body name="rd" pos="0 0.03 0.055"><inertial mass="0.009" pos="0 0.018 0.001" {moments}/>
          <joint name="rdj" armature="0.005"/>
          <body name="rc" pos="0 0.031 -0.004"><inertial mass="0.014" pos="0 0.003 0.023" {moments}/><joint name="rcj"/>
        </body></body>
        <body name="rs" pos="0 0.013 0.061" quat="1 0 {tilt} 0"><inertial mass="0.022" pos="0 0.018 0.021" {moments}/>
          <joint name="rsj" stiffness="0.05"/>
          <body name="rf" pos="0 0.055 0.0375"><inertial mass="0.0125" pos="0 -0.011 0.0125" {moments}/>
          <joint name="rfj" pos="0 -0.02 0.006"/></body></body></worldbody>
        <equality><connect anchor="0 0 0" body1="rf" body2="rc"/></equality>
        <actuator><motor joint="rdj"/></actuator></mujoco>"""
    )
    return path


WRITERS = {"four": four_bar, "five": five_bar}
FREEDOMS = {"four": 1, "five": 2}


def read(path: Path) -> tuple[Closure, np.ndarray]:
    """Return the closure of a file, and the accelerations from rest."""
    tree = assemble(build_tree(import_model(path).model))
    assert tree.closure is not None
    tape = straight(FUNCTIONS["exp1"].build(tree, ALL))
    given = {"q": list(tree.closure.pose)}
    found = evaluate(tape, {i.name: given.get(i.name, [0.0] * i.sparsity.nnz) for i in tape.inputs})
    return tree.closure, np.array(found["qdd"], float)


@pytest.mark.parametrize(
    ("kind", "tilt"), [("four", 1e-6), ("four", 5e-6), ("five", 1e-6), ("five", 1e-5), ("five", 1e-4)]
)
def test_a_small_tilt_is_rounding(kind: str, tilt: float, tmp_path: Path) -> None:
    """Planar equations are kept, within the digits of the file: 1e-5 of full ones, 3e-4 of few."""
    exact, expected = read(WRITERS[kind](tmp_path, 0.0))
    closure, found = read(WRITERS[kind](tmp_path, tilt))
    assert len(closure.independent) == len(exact.independent) == FREEDOMS[kind]
    assert exact.distance == 0.0
    assert 0.0 < closure.distance <= 3 * tilt
    np.testing.assert_allclose(found, expected, rtol=100 * tilt, atol=100 * tilt)


def check(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    """Run `mbsgen check`; return its exit code and all that it prints, in one line."""
    monkeypatch.setattr(sys, "argv", ["mbsgen", "check", *arguments])
    with pytest.raises(SystemExit) as end:
        main()
    code = end.value.code or 0
    assert isinstance(code, int)
    return code, " ".join("".join(capsys.readouterr()).split())


@pytest.mark.parametrize("tilt", [5e-4, 8e-4, 1e-3, 2e-3, 4e-3])
@pytest.mark.parametrize("kind", WRITERS)
def test_where_two_readings_are_near_the_command_line_chooses(
    kind: str, tilt: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A tilt that is larger than the digits is refused, with both readings and the option that chooses."""
    path = str(WRITERS[kind](tmp_path, tilt))
    code, told = check(monkeypatch, capsys, path)
    count = f"{FREEDOMS[kind]} degree{'s' if FREEDOMS[kind] > 1 else ''} of freedom"
    assert (code, count in told) == (2, True)
    assert "follow from the others within" in told
    tolerance = told.split("--loop-tolerance ")[1].split(")")[0]
    code, told = check(monkeypatch, capsys, path, "--loop-tolerance", tolerance)
    assert code == 0
    assert f"degrees of freedom: {FREEDOMS[kind]}" in told
    code, told = check(monkeypatch, capsys, path, "--loop-tolerance", "0")
    assert (code, "follow from" in told) == (2 if kind == "four" else 0, False)  # one planar bar is then locked
