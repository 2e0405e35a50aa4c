"""Shapes and meshes of bodies, of files that nobody vouches for."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from mbsgen.errors import InputError
from mbsrun import Mechanism
from mbsrun.animation import Motion, Part, Wanted, make_film
from mbsrun.animation.actors import BY_BODY
from mbsrun.animation.film import Kind, Layer
from mbsrun.animation.meshes import find_mesh, read_mesh, thin
from mbsrun.animation.visuals import give_mesh, read_visuals, show_drawings
from mbsrun.external import load
from mbsrun.models import Extent, list_undrawn

OBJ = "mtllib ../secret.mtl\nv 1 0 0\nv 3 0 0\nv 1 4 0\nv 1 0 6\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n"
URDF = """<robot name="r"><material name="red"><color rgba="1 0 0 1"/></material>
<link name="rod"><visual><origin xyz="0 0 -1" rpy="0 0 1.5707963267948966"/>
<geometry><mesh filename="{}" scale="2 2 2"/></geometry><material name="red"/></visual>
<visual><geometry><cylinder radius="0.1" length="0.5"/></geometry></visual></link></robot>"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Return the folder of a package with a mesh, beside a file that does not belong to it."""
    (tmp_path / "arm" / "meshes").mkdir(parents=True)
    (tmp_path / "arm" / "meshes" / "part.obj").write_text(OBJ)
    (tmp_path / "secret.obj").write_text(OBJ)
    return tmp_path / "arm"


def test_a_mesh_fills_its_box(package: Path) -> None:
    """Corners from (1, 0, 0) to (3, 4, 6): centre (2, 2, 3), edges 2, 4, 6."""
    body = read_mesh(package / "meshes" / "part.obj")
    assert body.centre.tolist() == [2, 2, 3]
    assert body.edges.tolist() == [2, 4, 6]
    assert (np.abs(body.mesh.vertices) == 0.5).all()
    assert len(body.mesh.faces) == 4


def test_visuals_of_a_link_move_with_its_body(pendulum: Mechanism, package: Path) -> None:
    """Scaled by 2, turned by a quarter about z, moved by -1 along z: (2, 2, 3) goes to (-4, 4, 5)."""
    file = package / "robot.urdf"
    file.write_text(URDF.format("package://arm/meshes/part.obj"))
    mesh, cylinder = found = read_visuals(file, (package.parent,), pytest.fail)
    assert mesh.at == pytest.approx([-4, 4, 5])
    assert mesh.size == pytest.approx([4, 8, 12])
    assert mesh.color == "#ff0000"
    assert (cylinder.kind, cylinder.size.tolist()) == (Kind.CYLINDER, [0.2, 0.2, 0.5])
    motion = Motion((Part(pendulum, np.array([0.0, 1.0]), np.zeros((2, 1))),))
    film = make_film([motion], Wanted(visuals=tuple(found)))
    layers = [solid.layer for solid in film.actors[0].solids]
    assert layers == [Layer.MESHES, Layer.MESHES]
    assert film.actors[0].solids[0].at == pytest.approx((-4, 4, 5))
    assert film.high == pytest.approx((0.1, 6, 11))


@pytest.mark.parametrize(
    ("name", "finding"),
    [
        ("package://arm/../secret.obj", "lies outside"),
        ("../secret.obj", "lies outside"),
        ("/etc/passwd", "lies outside"),
        ("package://leg/meshes/part.obj", "there is no mesh"),
        ("file:///etc/passwd", "no file of the description"),
        ("meshes/none.obj", "there is no mesh"),
    ],
)
def test_meshes_are_read_below_given_folders_alone(package: Path, name: str, finding: str) -> None:
    with pytest.raises(InputError, match=finding):
        find_mesh(name, package, (package,))
    warnings: list[str] = []
    (package / "robot.urdf").write_text(URDF.format(name))
    assert len(read_visuals(package / "robot.urdf", (package,), warnings.append)) == 1
    assert finding in warnings[0]


def test_a_link_out_of_the_folder_is_refused(package: Path) -> None:
    (package / "meshes" / "link.obj").symlink_to(package.parent / "secret.obj")
    with pytest.raises(InputError, match="lies outside"):
        find_mesh("meshes/link.obj", package, ())


@pytest.mark.parametrize(
    ("name", "content", "finding"),
    [
        ("a.stl", b"solid\n", "cannot be read as a mesh|no triangles"),
        ("a.glb", b"glTF" + bytes(40), "cannot be read as a mesh"),
        ("a.obj", b"v 0 0 0\n", "cannot be read as a mesh|no triangles"),
        ("a.obj", b"v 0 0 nan\nv 0 1 0\nv 1 0 0\nf 1 2 3\n", "no triangles with finite|cannot be read"),
        ("a.blend", b"", "found .blend at the end"),
    ],
)
def test_bad_meshes_are_refused(tmp_path: Path, name: str, content: bytes, finding: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=finding):
        give_mesh("rod", tmp_path / name)


def test_files_that_are_too_large_or_declare_entities_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.obj").write_text(OBJ)
    monkeypatch.setattr("mbsrun.animation.meshes.MAX_BYTES", 10)
    with pytest.raises(InputError, match="give a mesh of at most 10"):
        read_mesh(tmp_path / "a.obj")
    (tmp_path / "a.urdf").write_text('<!DOCTYPE r [<!ENTITY a "b">]><robot>&a;</robot>')
    with pytest.raises(InputError, match="declares an entity"):
        read_visuals(tmp_path / "a.urdf", (), pytest.fail)


def test_large_meshes_are_thinned() -> None:
    """A grid of 80000 triangles over a square keeps its corners within a cell, and its area."""
    n = 200
    x, y = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1))
    vertices = np.stack((x.ravel(), y.ravel(), 0 * x.ravel()), axis=1)
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    faces = np.concatenate((np.stack((a, a + 1, a + n + 2), 1), np.stack((a, a + n + 2, a + n + 1), 1)))
    fewer, kept = thin(vertices, faces, 20_000)
    assert 5_000 < len(kept) <= 20_000
    corners = fewer[kept]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2].sum() / 2
    assert area == pytest.approx(1, abs=0.05)


DRAWN = """name: rod
gravity: [0, 0, -9.81]
bodies:
  - name: rod
    joint: {type: revolute, axis: x, position: [0, 0, 1]}
    mass: 1
    com: [0, 0, -0.5]
    inertia: [0.1, 0.1, 0.1]
    visual:
      - {shape: capsule, radius: 0.1, length: 0.6, position: [0, 0, -0.5]}
      - {shape: mesh, file: arm/meshes/part.obj, scale: 0.1, color: "#d55e00"}
      - {shape: mesh, file: missing.obj}
"""


def test_shapes_of_a_model_are_drawn(package: Path) -> None:
    """A capsule is a cylinder and two balls, 0.3 m from its centre; the mesh has its centre at 0.1 (2, 2, 3)."""
    (package.parent / "rod.yaml").write_text(DRAWN)
    rod = load(package.parent / "rod.yaml", extent=Extent(("frames",), derivatives=0))
    warnings: list[str] = []
    tube, low, high, mesh = show_drawings(rod.manifest, package.parent, warnings.append)
    assert [x.kind for x in (tube, low, high, mesh)] == [Kind.CYLINDER, Kind.ELLIPSOID, Kind.ELLIPSOID, Kind.MESH]
    assert (low.at[2], high.at[2]) == pytest.approx((-0.8, -0.2))
    assert mesh.at == pytest.approx([0.2, 0.2, 0.3])
    assert mesh.size == pytest.approx([0.2, 0.4, 0.6])
    assert len(warnings) == 1
    assert "there is no mesh missing.obj" in warnings[0]
    motion = Motion((Part(rod, np.array([0.0, 1.0]), np.zeros((2, 1))),))
    solids = make_film([motion]).actors[0].solids  # without the model's folder
    assert [x.kind for x in solids] == [Kind.CYLINDER, Kind.ELLIPSOID, Kind.ELLIPSOID]
    assert {x.color for x in solids} == {BY_BODY.solids[0]}


ROBOT = """<mujoco><compiler meshdir="arm/meshes"/>
<default><default class="hidden"><geom group="3"/></default></default>
<asset><mesh name="part" file="part.obj" scale="0.1 -0.1 0.1"/><mesh name="old" file="part.msh"/></asset>
<worldbody><geom type="plane" size="1 1 1"/><body name="arm" pos="0 0 1" euler="10 20 30">
<joint name="first" axis="0 1 0" pos="0.1 0 0.2"/><geom type="capsule" fromto="0 0 0 0.5 0.1 0" size="0.05"/>
<frame pos="0.1 0 0" quat="0.8 0.6 0 0"><geom type="box" size="0.1 0.2 0.3" rgba="1 0 0 1" pos="0 0.1 0"/></frame>
<geom class="hidden" size="1" mass="0"/><geom type="mesh" mesh="old" mass="0"/>
<body name="hand" pos="0.5 0 0"><joint name="second" axis="1 0 0"/>
<geom type="ellipsoid" size="0.1 0.15 0.05" zaxis="1 1 0"/><geom type="mesh" mesh="part" pos="0 0 1" mass="0"/>
</body></body></worldbody></mujoco>"""


def test_geoms_are_where_mujoco_has_them(package: Path) -> None:
    """MuJoCo's geoms at a pose, against the film's solids of the imported model; hidden groups are not drawn."""
    file = package.parent / "robot.xml"
    file.write_text(ROBOT)
    plain = "".join(x for x in ROBOT.splitlines(keepends=True) if "<asset>" not in x)  # its OBJ is no closed solid
    peer = mujoco.MjModel.from_xml_string(re.sub(r'<geom type="mesh"[^>]*>', "", plain))
    state, q = mujoco.MjData(peer), np.array([0.3, -0.7])
    state.qpos[:] = q
    mujoco.mj_forward(peer, state)
    with pytest.warns(UserWarning, match="they pass through"):
        robot = load(file, extent=Extent(("frames",), derivatives=0))
    visuals = tuple(show_drawings(robot.manifest, package.parent, pytest.fail))
    film = make_film([Motion((Part(robot, np.zeros(1), q[None]),))], Wanted(visuals=visuals))
    tube, _, _, box, egg, mesh = film.actors[0].solids
    places, track = {}, film.tracks[0]
    for solid in (tube, box, egg, mesh):
        R = track.R[0, solid.frame]
        axes = R @ np.array(solid.axes).reshape(3, 3).T
        places[solid] = track.p[0, solid.frame] + R @ np.array(solid.at), axes @ np.diag(np.square(solid.size)) @ axes.T
    halves = [[0.05, 0.05, peer.geom_size[1][1]], peer.geom_size[2], peer.geom_size[4]]
    for solid, k, half in zip((tube, box, egg), (1, 2, 4), halves, strict=True):
        at, spread = places[solid]
        C = state.geom_xmat[k].reshape(3, 3)
        assert at == pytest.approx(state.geom_xpos[k], abs=1e-12)
        assert spread == pytest.approx(C @ np.diag(np.square(2 * np.array(half))) @ C.T, abs=1e-12)
    hand = state.xmat[2].reshape(3, 3)
    assert places[mesh][0] == pytest.approx(state.xpos[2] + hand @ [0.2, -0.2, 1.3], abs=1e-12)
    assert (box.color, mesh.size) == ("#ff0000", pytest.approx((0.2, 0.4, 0.6)))
    assert [x.split(": ")[-1] for x in list_undrawn(file)] == [
        '"arm/meshes/part.msh" is none of .stl, .obj, .glb, .gltf, .ply'
    ]
