"""Shapes of bodies in model files: what is read, what is refused, and that no equation knows of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from mbsgen import manifest
from mbsgen.errors import InputError
from mbsgen.model.reader import read_model
from mbsgen.model.writer import write_model
from mbsgen.pipeline import Options, generate

PLAIN = """name: rod
gravity: [0, 0, -9.81]
parameters: {l: 0.5}
bodies:
  - name: rod
    joint: {type: revolute, axis: y, position: [0, 0, 1]}
    mass: 1
    com: [0, 0, l/2]
    inertia: [0.1, 0.1, 0.01]
"""
SHAPES = """    visual:
      - {shape: box, size: [l, 0.1, 0.2], position: [0, 0, l/2], orientation: [{axis: z, angle: pi/2}]}
      - {shape: capsule, radius: 0.1, length: l, color: "#D55E00"}
      - {shape: mesh, file: meshes/rod.stl, scale: 0.001}
"""


def test_shapes_change_the_manifest_alone(tmp_path: Path) -> None:
    """The C, the hash of the kernels and the hash of the mechanism are the same with shapes and without."""
    found = {}
    for name, text in (("plain", PLAIN), ("shown", PLAIN + SHAPES)):
        (tmp_path / f"{name}.yaml").write_text(text)
        generate(tmp_path / f"{name}.yaml", tmp_path / name, Options(functions=("frames",), derivatives=0))
        found[name] = {x.name: x.read_bytes() for x in (tmp_path / name).rglob("*") if x.is_file()}
    differing = {name for name in found["plain"] if found["plain"][name] != found["shown"].get(name)}
    assert (differing, found["plain"].keys()) == ({manifest.FILE_NAME}, found["shown"].keys())
    plain, shown = (manifest.read(tmp_path / name / manifest.FILE_NAME) for name in ("plain", "shown"))
    assert (plain.model_hash, plain.mechanism) == (shown.model_hash, shown.mechanism)
    assert plain.appearance is not None
    assert shown.appearance is not None
    assert shown.appearance.model_copy(update={"drawings": ()}) == plain.appearance
    box, capsule, mesh = shown.appearance.drawings
    assert (box.shape, box.size, box.at, box.color) == ("box", (0.5, 0.1, 0.2), (0.0, 0.0, 0.25), "")
    assert box.axes == pytest.approx((0, 1, 0, -1, 0, 0, 0, 0, 1), abs=1e-15)
    assert (capsule.size, capsule.color) == ((0.1, 0.5), "#d55e00")
    assert (mesh.size, mesh.file) == ((0.001,) * 3, "meshes/rod.stl")


def test_shapes_are_written_as_they_are_read(tmp_path: Path) -> None:
    file = tmp_path / "rod.yaml"
    file.write_text(PLAIN + SHAPES)
    model = read_model(file)
    file.write_text(write_model(model))
    assert read_model(file) == model


@pytest.mark.parametrize(
    ("visual", "place", "finding", "remedy"),
    [
        ("{shape: cone, radius: 1}", "bodies[0].visual.shape", 'found "cone"', "cylinder"),
        ("{shape: box, size: [1, 0, 1]}", "bodies[0].visual[0].size[1]", "found 0", "more than 0"),
        ("[{shape: sphere, radius: -l}]", "bodies[0].visual[0].radius", "found -0.5", "more than 0"),
        ("{shape: sphere, radius: 1, color: red}", "bodies[0].visual.color", 'found "red"', "#0072b2"),
        ("{shape: mesh, file: ../rod.stl}", "bodies[0].visual.file", "leads out of", "below that folder"),
        ("{shape: mesh, file: /rod.stl}", "bodies[0].visual.file", "leads out of", "below that folder"),
        ("{shape: mesh, file: 'file:rod.stl'}", "bodies[0].visual.file", "leads out of", "below that folder"),
        ("{shape: mesh, file: rod.txt}", "bodies[0].visual.file", "is no mesh", ".stl"),
        ("{shape: mesh, file: rod.stl, scale: [1, 2]}", "bodies[0].visual.scale", "found [1, 2]", "one number"),
    ],
)
def test_a_faulty_shape_is_refused(visual: str, place: str, finding: str, remedy: str, tmp_path: Path) -> None:
    file = tmp_path / "rod.yaml"
    file.write_text(PLAIN + f"    visual: {visual}\n")
    with pytest.raises(InputError) as raised:
        read_model(file)
    (fault,) = raised.value.faults
    assert (fault.line, fault.path) == (10, place)
    assert finding in fault.finding
    assert remedy in fault.remedy
