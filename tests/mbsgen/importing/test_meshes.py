"""The solids of meshes are MuJoCo's, by each of its rules, and refused where it refuses them.

MuJoCo keeps corners in single precision, and so do files of STL: TOLERANCE is some of its digits.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen.errors import InputError
from mbsgen.expressions import Number
from mbsgen.importing import import_model
from mbsgen.importing.mjcf.mesh_solids import RULES, Rule, measure
from mbsgen.model.orientations import turn_quaternion
from tests.import_peers import Kernels, MujocoPeer, largest_miss

Array = NDArray[np.float64]
TOLERANCE = 1e-6
OUTLINE = np.array([(0, 0), (2, 0), (2, 1), (1, 1), (1, 3), (0, 3)]) / 10  # an L
LIDS = ((0, 1, 2), (0, 2, 3), (0, 3, 5), (3, 4, 5))
HEIGHT = 0.07


def make_angle() -> tuple[Array, NDArray[np.int64]]:
    """Make a prism that is not convex."""
    n = len(OUTLINE)
    corners = np.concatenate([np.c_[OUTLINE, np.zeros(n)], np.c_[OUTLINE, np.full(n, HEIGHT)]])
    faces = [(a, c, b) for a, b, c in LIDS] + [(a + n, b + n, c + n) for a, b, c in LIDS]
    for i in range(n):
        j = (i + 1) % n
        faces += [(i, j, j + n), (i, j + n, i + n)]
    return corners, np.array(faces)


def show(numbers: Array | NDArray[np.int64]) -> str:
    return " ".join(map(repr, numbers.ravel().tolist()))


def write_stl(corners: Array, faces: NDArray[np.int64]) -> bytes:
    rows = b"".join(struct.pack("<12fH", 0, 0, 0, *corners[face].ravel(), 0) for face in faces)
    return bytes(80) + struct.pack("<I", len(faces)) + rows


def write_msh(corners: Array, faces: NDArray[np.int64], *, more: bool = False) -> bytes:
    """Write corners and triangles; `more`: normals and texture coordinates, of no meaning here, between them."""
    n = len(corners)
    extra = struct.pack(f"<{5 * n}f", *range(5 * n)) if more else b""
    counts = struct.pack("<4i", n, n * more, n * more, len(faces))
    places = struct.pack(f"<{3 * n}f", *corners.ravel())
    return counts + places + extra + struct.pack(f"<{faces.size}i", *faces.ravel())


def write_obj(corners: Array, faces: NDArray[np.int64]) -> str:
    return (
        "mtllib secret.mtl\n"
        + "".join(f"v {show(x)}\n" for x in corners)
        + "".join(f"f {show(x + 1)}\n" for x in faces)
    )


def write(folder: Path, mesh: str, geom: str = "", compiler: str = "") -> Path:
    """Write a file of one body, whose mass is a mesh's."""
    path = folder / "machine.xml"
    path.write_text(
        f"""<mujoco><compiler {compiler}/><asset><mesh name="m" {mesh}/></asset><worldbody>
        <body name="rod" pos="0 0 1"><joint axis="0 1 1"/><joint axis="1 0 0"/><joint axis="0 0 1" pos="0 0.1 0"/>
        <geom type="mesh" mesh="m" pos="0.1 0.2 0" euler="10 20 30" {geom}/></body></worldbody></mujoco>""",
        encoding="utf-8",
    )
    return path


def assert_mujoco_agrees(path: Path) -> None:
    kernels, peer = Kernels(import_model(path), ("semi",)), MujocoPeer(path)
    for state in kernels.draw_states():
        for name, miss in largest_miss(kernels.compute(state), peer.compute(state)).items():
            assert miss < TOLERANCE, name


def refuse(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        import_model(path)
    return str(caught.value)


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("more", ["", 'scale="-1 2 1"', 'refpos="0.1 0.2 0.3" refquat="0.9 0.1 0.2 0.3" scale="1 2 1"'])
def test_meshes_of_the_file(rule: Rule, more: str, tmp_path: Path) -> None:
    corners, faces = make_angle()
    path = write(tmp_path, f'vertex="{show(corners)}" face="{show(faces)}" inertia="{rule}" {more}')
    assert_mujoco_agrees(path)


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("name", ["m.stl", "m.obj", "M.STL", "m.msh"])
def test_meshes_of_other_files(rule: Rule, name: str, tmp_path: Path) -> None:
    """Below the folder of meshes; their materials are not opened."""
    corners, faces = make_angle()
    folder = tmp_path / "parts"
    folder.mkdir()
    if name.lower().endswith("stl"):
        (folder / name).write_bytes(write_stl(corners, faces))
    elif name.endswith("msh"):
        (folder / name).write_bytes(write_msh(corners, faces, more=rule == "exact"))
    else:
        (folder / name).write_text(write_obj(corners, faces))
    assert_mujoco_agrees(write(tmp_path, f'file="{name}" inertia="{rule}"', 'density="300"', 'meshdir="parts"'))


CUBE = "".join(f"v {x} {y} {z}\n" for x, y, z in
               [(0, 0, 0), (1, 0, 0), (1, 1, 0.3), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)])  # fmt: skip
SIDES = "f 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n"
FAR = "v 5 5 5\nv 6 5 5\nv 5 6 5\nv 5 5 7\nf -1 -2 -3\nf -2 -3 -4\n"
PYRAMID = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0.5 2 0\nv 0 1 0\nv 0.5 0.5 1\n"


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize(
    "text",
    [
        CUBE + "f 4 3 2 1\n" + SIDES,
        CUBE + "f 3 2 1 4\n" + SIDES,
        "o box\n" + CUBE + "f 4 3 2 1\n" + SIDES + "o tip\n" + FAR,
        "g box\ng box\n" + CUBE + "f 4 3 2 1\ng rest\n" + SIDES + FAR,
        "g box\ng box\n" + CUBE + "f 4 3 2 1\ng\n" + SIDES + "g rest\n" + FAR,
        "o box\n" + CUBE + "usemtl a\nf 4 3 2 1\nusemtl b\ns 1\n" + SIDES,
        PYRAMID + "f 5 4 3 2 1\n" + "".join(f"f {i} {i % 5 + 1} 6\n" for i in range(1, 6)),
        CUBE + "v 3 3 3\nv 0 0 2 1 0 0\n",
    ],
)
def test_what_counts_of_a_file_of_obj(rule: Rule, text: str, tmp_path: Path) -> None:
    """The first object or group with faces, the shorter diagonal, and all corners for the hull."""
    if rule == "exact" and "1\ng rest" in text:
        return  # one side alone encloses nothing
    (tmp_path / "m.obj").write_text(text)
    path = write(tmp_path, f'file="m.obj" inertia="{rule}"')
    assert_mujoco_agrees(path)
    told = [notice.text for notice in import_model(path).notices]
    assert any("faces of further objects are left out" in each for each in told) == (FAR in text)


FITTED = ("sphere", "box", "capsule", "cylinder", "ellipsoid")


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("shape", FITTED)
@pytest.mark.parametrize("more", ["", 'shellinertia="true" fitscale="1.3" size="7"'])
def test_shapes_fitted_to_a_mesh(rule: Rule, shape: str, more: str, tmp_path: Path) -> None:
    corners, faces = make_angle()
    path = write(tmp_path, f'vertex="{show(corners)}" face="{show(faces)}" inertia="{rule}"', more)
    path.write_text(path.read_text().replace('type="mesh"', f'type="{shape}"'))
    assert_mujoco_agrees(path)
    (drawn,) = import_model(path).model.bodies[0].visuals
    assert drawn.shape == shape


def test_a_mesh_without_a_type_is_a_sphere_fitted_to_it(tmp_path: Path) -> None:
    """As MuJoCo reads it: the usual type of a geom, or its class's, stays."""
    corners, faces = make_angle()
    path = write(tmp_path, f'vertex="{show(corners)}" face="{show(faces)}"')
    path.write_text(path.read_text().replace('type="mesh"', ""))
    assert_mujoco_agrees(path)


def make_block(sizes: tuple[float, float, float]) -> Array:
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    return (corners * 0.1 + 0.3) * sizes


@pytest.mark.parametrize("shape", FITTED)
def test_shapes_fitted_to_the_box_of_a_mesh(shape: str, tmp_path: Path) -> None:
    """With `fitaabb`, the box of the corners along the principal axes; of equal axes, the mesh's own ones."""
    plates = () if shape == "capsule" else ((0.5, 1, 1),)  # whose capsule would have no length
    blocks = [make_block(sizes) for sizes in ((1, 1, 2), (1, 2, 3), *plates)]
    for corners in (make_angle()[0], *blocks):
        path = write(tmp_path, f'vertex="{show(corners)}"', 'fitscale="1.1"', 'fitaabb="true"')
        path.write_text(path.read_text().replace('type="mesh"', f'type="{shape}"'))
        assert_mujoco_agrees(path)


@pytest.mark.parametrize("shape", FITTED)
def test_shapes_fitted_to_a_cube(shape: str, tmp_path: Path) -> None:
    """Its axes are equal: they are the mesh's own, unless rounded corners leave the choice to MuJoCo's rounding."""
    cube = make_block((1, 1, 1))
    for turned in ("", 'refquat="0.9 0.1 0.2 0.3"'):
        path = write(tmp_path, f'vertex="{show(cube)}" {turned}')
        path.write_text(path.read_text().replace('type="mesh"', f'type="{shape}"'))
        assert_mujoco_agrees(path)
    path = write(tmp_path, f'vertex="{show(cube @ turn_quaternion((0.9, 0.1, 0.2, 0.3)))}"')
    path.write_text(path.read_text().replace('type="mesh"', f'type="{shape}"'))
    if shape in ("capsule", "cylinder"):
        assert "has equal axes" in refuse(path)
    else:
        assert_mujoco_agrees(path)


def test_a_mesh_has_no_shell_by_its_geom(tmp_path: Path) -> None:
    path = write(tmp_path, f'vertex="{show(make_block((1, 1, 1)))}"')
    path.write_text(path.read_text().replace('type="mesh"', 'type="mesh" shellinertia="true"'))
    assert "shellinertia of a mesh" in refuse(path)


def test_a_mesh_may_be_beside_the_file_that_defines_it(tmp_path: Path) -> None:
    """MuJoCo looks in the folder of meshes, then at the included file's place in that folder."""
    path = write(tmp_path, 'file="angle.obj"')
    text = path.read_text()
    asset = text[text.index("<asset>") : text.index("</asset>") + len("</asset>")]
    path.write_text(text.replace(asset, '<include file="parts/asset.xml"/>'))
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "asset.xml").write_text(f"<mujocoinclude>{asset}</mujocoinclude>")
    assert "there is no such file" in refuse(path)
    corners, faces = make_angle()
    for folder, scale in ((tmp_path / "parts", 1.0), (tmp_path, 2.0)):
        (folder / "angle.obj").write_text(write_obj(scale * corners, faces))
        assert_mujoco_agrees(path)


def test_points_have_the_solid_of_their_hull(tmp_path: Path) -> None:
    assert_mujoco_agrees(write(tmp_path, f'vertex="{show(make_angle()[0])}"', 'mass="0.3"'))


@pytest.mark.parametrize("rule", ["legacy", "exact", "shell"])
def test_open_surfaces(rule: Rule, tmp_path: Path) -> None:
    corners, faces = make_angle()
    path = write(tmp_path, f'vertex="{show(corners)}" face="{show(faces[:-1])}" inertia="{rule}"')
    assert_mujoco_agrees(path)


def test_a_prism_has_its_volume_and_moments() -> None:
    """Two boxes: a closed form, to rounding. The legacy rule counts more, the hull adds a triangle's prism."""
    corners, faces = make_angle()
    exact = measure(corners, faces, "exact")
    boxes = ((0.2, 0.1, (0.1, 0.05)), (0.1, 0.2, (0.05, 0.2)))
    areas = np.array([a * b for a, b, _ in boxes])
    centre = areas @ [c for *_, c in boxes] / areas.sum()
    np.testing.assert_allclose(exact.mass, areas.sum() * HEIGHT, rtol=1e-14)
    np.testing.assert_allclose(exact.com, [*centre, HEIGHT / 2], rtol=1e-14)
    polar = sum(a * b * ((a * a + b * b) / 12 + ((np.array(c) - centre) ** 2).sum()) for a, b, c in boxes)
    np.testing.assert_allclose(exact.inertia[2, 2], polar * HEIGHT, rtol=1e-13)
    assert measure(corners, faces, "legacy").mass > exact.mass
    np.testing.assert_allclose(measure(corners, faces, "convex").mass, (areas.sum() + 0.01) * HEIGHT, rtol=1e-14)


@pytest.mark.parametrize(
    ("mesh", "text"),
    [
        ('vertex="0 0 0 1 0 0 0 1 0 1 1 0"', "enclose no volume"),
        ('vertex="0 0 0 1 0 0"', "neither a file nor four vertices"),
        ('vertex="0 0 0 1 0 0 0 1 0 x 1 1"', "no numbers"),
        ('vertex="0 0 0 1 0 0 0 1 0 0 0 1" face="0 1 9"', "no triangles with finite corners"),
        ('vertex="0 0 0 1 0 0 0 1 0 0 0 1" inertia="some"', 'inertia is "some"'),
        ('vertex="0 0 0 1 0 0 0 1 0 0 0 1" maxhullvert="4"', "a hull of fewer corners"),
        ('vertex="0 0 0 1 0 0 0 1 0 0 0 1" scale="0 1 1"', "scale or refquat of the mesh is 0"),
        ('builtin="sphere" params="1"', "a mesh that MuJoCo makes"),
        ('file="m.ply"', "a mesh in .ply is not computed here"),
        ('file="bad.msh"', "bad.msh cannot be read as a mesh: its counts are of another size"),
        ('file="bad.stl" content_type="model/vnd.mujoco.msh"', "bad.stl cannot be read as a mesh: its counts"),
        ('file="none.stl"', "the mesh none.stl: there is no such file"),
        ('file="bad.stl"', "bad.stl cannot be read as a mesh"),
        ('file="star.obj"', "a face of 5 corners is not convex"),
        ('file="cut.obj"', "a face has a corner that does not exist"),
        ('file="odd.obj"', "line 2 is not a line of an OBJ file"),
        ('file="long.obj"', "line 1 continues in the next line"),
        ('file="../m.stl"', "is not in the folder of the model"),
    ],
)
def test_meshes_without_a_solid_are_refused(mesh: str, text: str, tmp_path: Path) -> None:
    (tmp_path / "bad.stl").write_bytes(b"solid \xff\xff nothing")
    (tmp_path / "bad.msh").write_bytes(write_msh(*make_angle())[:-1])
    (tmp_path / "star.obj").write_text(PYRAMID.replace("0.5 2 0", "0.5 0.5 0") + "f 5 4 3 2 1\n")
    (tmp_path / "cut.obj").write_text(CUBE + "f 1 2 9\n")
    (tmp_path / "odd.obj").write_text("v 0 0 0\nv 0 x 0\n")
    (tmp_path / "long.obj").write_text("v 0 \\\n0 0\n")
    assert text in refuse(write(tmp_path, mesh))


@pytest.mark.parametrize(("change", "text"), [("turn one", "show different sides"), ("turn all", "a volume of -")])
def test_what_the_exact_rule_refuses(change: str, text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As MuJoCo does."""
    import mujoco

    monkeypatch.chdir(tmp_path)  # MuJoCo logs where it runs
    corners, faces = make_angle()
    turned = faces[:, ::-1] if change == "turn all" else np.concatenate([faces[:1, ::-1], faces[1:]])
    path = write(tmp_path, f'vertex="{show(corners)}" face="{show(turned)}" inertia="exact"')
    with pytest.raises(ValueError, match=r"."):
        mujoco.MjModel.from_xml_path(str(path))
    assert text in refuse(path)


def test_a_mesh_of_a_body_that_stands_needs_no_solid(tmp_path: Path) -> None:
    path = tmp_path / "machine.xml"
    path.write_text(
        """<mujoco><asset><mesh name="m" file="none.stl"/></asset><worldbody>
        <body name="mount"><geom type="mesh" mesh="m"/><body name="arm"><joint/>
        <inertial pos="1 0 0" mass="1" diaginertia="1 1 1"/><geom type="mesh" mesh="m"/></body></body>
        </worldbody></mujoco>"""
    )
    imported = import_model(path)
    assert [body.mass for body in imported.model.bodies] == [Number(0.0), Number(1.0)]
    assert any("which nothing would feel here" in notice.text for notice in imported.notices)
