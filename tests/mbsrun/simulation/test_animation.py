"""The page that plays a motion: what it holds, and what names from untrusted files cannot make of it."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mbsgen.manifest import Manifest
from mbsrun import Mechanism
from mbsrun.animation import (
    MAX_PICTURES,
    RATE,
    Marker,
    Motion,
    Part,
    choose_times,
    make_film,
    render_animation,
    write_animation,
)
from mbsrun.animation.forces import find_loads
from mbsrun.external import load
from mbsrun.models import Extent
from mbsrun.skeleton import place

HOSTILE = "</script><script>alert(1)</script><!-- \u2028 & @SCRIPT@ é"


class Page(HTMLParser):
    """Collects what a browser would take for scripts, and every address that it might ask for."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.scripts: list[tuple[str, str]] = []  # type, text
        self.addresses: list[str] = []
        self.policy = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.addresses += [value or "" for key, value in attrs if key in ("src", "href", "action", "srcset")]
        if tag == "script":
            self.scripts.append((given.get("type") or "", ""))
        if given.get("http-equiv") == "Content-Security-Policy":
            self.policy = given["content"] or ""

    def handle_data(self, data: str) -> None:
        if self.cdata_elem == "script":
            kind, text = self.scripts[-1]
            self.scripts[-1] = (kind, text + data)

    @property
    def motion(self) -> dict[str, Any]:
        return json.loads(self.scripts[0][1])


@dataclass(frozen=True)
class Renamed:
    """A mechanism under another model's manifest."""

    plant: Mechanism
    manifest: Manifest

    def __call__(self, name: str, /, **inputs: Any) -> dict[str, Any]:
        return self.plant(name, **inputs)

    def casadi(self, name: str) -> Any:
        return self.plant.casadi(name)


def swing(count: int) -> tuple[Any, Any, Any]:
    t = np.linspace(0, 2, count)
    return t, np.sin(3 * t)[:, None], 3 * np.cos(3 * t)[:, None]


def decode(motion: dict[str, Any]) -> tuple[Any, Any]:
    """Return positions (K, F, 3) and quaternions (K, F, 4), as the page's script reads them."""
    (mechanism,), (course,) = motion["scene"]["mechanisms"], motion["courses"]
    shape = (motion["times"], len(mechanism["frames"]))
    places = np.frombuffer(base64.b64decode(course["places"]), "<f4").reshape(*shape, 3)
    turns = np.frombuffer(base64.b64decode(course["turns"]), "<i2").reshape(*shape, 4)
    return places, turns / 32767


def test_the_page_holds_the_poses_of_the_motion(pendulum: Mechanism) -> None:
    """The rod's tip is at (-sin q, 0, -cos q), and its frame turned about y by q: (0, sin q/2, 0, cos q/2).

    Tolerances are the roundings of float32 and of 16 bits, and h^4/384 max |q''''| of the cubic between given times.
    """
    t, q, qd = swing(41)
    motion = Page(render_animation(pendulum, t, q, qd=qd, markers=[Marker("goal", (1, 2, 3))])).motion
    grid = np.linspace(0, 2, motion["times"])
    angle = np.sin(3 * grid)
    places, turns = decode(motion)
    cubic = 0.05**4 / 384 * 81
    tip = np.stack((-np.sin(angle), 0 * angle, -np.cos(angle)), axis=1)
    assert np.abs(places[:, 1] - tip).max() < cubic + 1e-7
    assert np.abs(turns[:, 1, 1] - np.sin(angle / 2)).max() < cubic + 2e-5
    assert np.abs(turns[:, 1, 3] - np.cos(angle / 2)).max() < cubic + 2e-5
    assert motion["title"] == "pendulum"
    assert motion["scene"]["markers"] == [{"name": "goal", "at": [1.0, 2.0, 3.0]}]
    assert [frame["parent"] for frame in motion["scene"]["mechanisms"][0]["frames"]] == [-1, 0]


def test_names_stay_names(pendulum: Mechanism) -> None:
    """However a model, a frame or a target is called, the page has the same two scripts, and reads the name back."""
    t, q, _ = swing(3)
    frames = tuple(frame.model_copy(update={"name": HOSTILE}) for frame in pendulum.manifest.frames)
    hostile = Renamed(pendulum, pendulum.manifest.model_copy(update={"model": HOSTILE, "frames": frames}))
    plain, page = (Page(render_animation(plant, t, q)) for plant in (pendulum, hostile))
    marked = Page(render_animation(pendulum, t, q, title=HOSTILE, markers=[Marker(HOSTILE, (0, 0, 0))]))
    for found in (page, marked):
        assert [kind for kind, _ in found.scripts] == ["application/json", ""]
        assert found.scripts[1] == plain.scripts[1]
        assert found.motion["title"] == HOSTILE
    assert {frame["name"] for frame in page.motion["scene"]["mechanisms"][0]["frames"]} == {HOSTILE}
    assert marked.motion["scene"]["markers"][0]["name"] == HOSTILE


def test_the_page_asks_for_nothing_and_admits_its_own_script_only(pendulum: Mechanism) -> None:
    t, q, _ = swing(3)
    text = render_animation(pendulum, t, q)
    page = Page(text)
    assert page.addresses == []
    assert not re.search(r"https?:|url\(|@import|fetch\(|import\(|innerHTML|eval", text)
    digest = base64.b64encode(hashlib.sha256(page.scripts[1][1].encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in page.policy
    assert "default-src 'none'" in page.policy


def test_the_same_motion_gives_the_same_bytes(pendulum: Mechanism, tmp_path: Path) -> None:
    t, q, qd = swing(50)
    for name in ("one", "two"):
        write_animation(tmp_path / name, pendulum, t, q, qd=qd)
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()


@pytest.mark.parametrize(("end", "count"), [(0.0, 1), (1.0, 26), (0.01, 2), (1e5, MAX_PICTURES)])
def test_pictures_are_as_many_as_the_eye_sees(end: float, count: int) -> None:
    grid = choose_times(0.0, end)
    assert len(grid) == count
    assert (grid[0], grid[-1]) == (0.0, end)
    assert (np.diff(grid) <= 1.0001 / RATE).all() or count == MAX_PICTURES


@pytest.mark.parametrize(
    ("t", "q"), [([0, 1], [[0.0]]), ([1, 0], [[0.0], [0.0]]), ([0], [[0.0, 1.0]]), ([], np.zeros((0, 1)))]
)
def test_arrays_that_do_not_fit_are_refused(pendulum: Mechanism, t: Any, q: Any) -> None:
    with pytest.raises(ValueError, match="shape"):
        render_animation(pendulum, t, q)
    with pytest.raises(ValueError, match="qd has shape"):
        render_animation(pendulum, [0, 1], [[0], [1]], qd=[[0]])


TOUCHING = """name: touching
gravity: [0, 0, -9.81]
bodies:
  - name: crate
    joint: {type: floating}
    mass: 2
    inertia: [0.02, 0.02, 0.02]
  - name: bob
    parent: crate
    joint: {type: spherical, position: [0.1, 0, 0.2]}
    mass: 1
    com: [0, 0, 0.1]
    inertia: [0.01, 0.01, 0.01]
  - name: slope
    joint: {type: prismatic, axis: x, orientation: [{axis: y, angle: 0.2}]}
    mass: 3
contacts:
  - {name: box, body: crate, size: [0.3, 0.2, 0.1], orientation: [{axis: z, angle: 0.3}], stiffness: 400, width: 0.05,
     exponent: 2.5, dissipation: 0.3, friction: {coefficient: 0.5, speed: 0.1}}
  - {name: ball, body: bob, position: [0, 0, 0.1], radius: 0.1, plane: {body: slope, normal: [0, 0.6, 0.8]},
     stiffness: 90, exponent: 1, width: 0.1, friction: {coefficient: 0.3, speed: 0.2}}
forces:
  - {name: strut, from: {body: base, position: [1, 0, 1]}, to: {body: crate}, stiffness: 50, rest: 0.2, damping: 3}
  - {name: rope, type: cable, from: {body: bob}, to: {body: crate, position: [0, 0.3, 0]}, stiffness: 70, rest: 0.1,
     width: 0.05, dissipation: 0.4}
"""
MERE = TOUCHING[: TOUCHING.index("contacts:")]


def test_arrows_are_the_forces_that_the_kernels_compute(tmp_path: Path) -> None:
    """Power of all arrows = power of the model's forces: qd.(Phi without forces - Phi with them), at random states.

    The slope's part is its reaction; the crate and the bob bear all others. Differences along the rates err by 1e-8.
    """
    plants = []
    for name, text in (("touching", TOUCHING), ("mere", MERE)):
        (tmp_path / f"{name}.yaml").write_text(text)
        plants.append(load(tmp_path / f"{name}.yaml", extent=Extent(("impl", "frames"), derivatives=0)))
    touching = plants[0]
    rng = np.random.default_rng(3)
    q, qd = 0.1 * rng.normal(size=(2, 20, len(touching.manifest.coordinates)))
    q[:, -1], qd[:, -1] = 0.0, 0.0  # the slope stands, so its reactions have no power
    zero = np.zeros_like(q)
    u = np.zeros((len(q), len(touching.manifest.actuated)))
    with_forces, without = (x("impl", q=q, qd=qd, qdd=zero, u=u)["Phi"] for x in plants)
    power = np.einsum("ki,ki->k", qd, without - with_forces)
    now, after, before = (place(touching, q + step * qd) for step in (0.0, 1e-6, -1e-6))
    found = np.zeros(len(q))
    for found_load in find_loads(touching, q, qd):
        i, at = found_load.foot.frame, np.array(found_load.foot.at)
        p = [x.p[:, :, i] + x.R[:, :, 3 * i : 3 * i + 3] @ at for x in (now, after, before)]
        found += np.einsum("ki,ki->k", found_load.values, (p[1] - p[2]) / 2e-6)
        if np.linalg.norm(at - [0, 0, 0.1]) < 1e-12:  # of the ball: its force acts at its surface
            n = np.array([[np.cos(0.2), 0, np.sin(0.2)], [0, 1, 0], [-np.sin(0.2), 0, np.cos(0.2)]]) @ [0, 0.6, 0.8]
            spin = (after.R - before.R)[:, :, 3 * i : 3 * i + 3] / 2e-6 @ now.R[:, :, 3 * i : 3 * i + 3].swapaxes(1, 2)
            found += np.einsum("ki,ki->k", found_load.values, spin @ (-0.1 * n))
    assert np.abs(power).max() > 1
    assert found == pytest.approx(power, abs=1e-6)


def test_forces_of_impacts_do_not_shorten_all_others(tmp_path: Path) -> None:
    """Arrows of a box at rest on four corners are seen: each a fair part of the mechanism's size."""
    (tmp_path / "touching.yaml").write_text(MERE + "contacts: [{name: foot, body: crate, stiffness: 1e4, exponent: 1}]")
    plant = load(tmp_path / "touching.yaml", extent=Extent(("frames",), derivatives=0))
    t = np.linspace(0, 2, 101)
    q = np.zeros((101, len(plant.manifest.coordinates)))
    q[:, 2] = -1e-3
    q[0, 2] = -0.5  # an impact
    (arrow,) = make_film([Motion((Part(plant, t, q),))]).tracks[0].arrows
    lengths = arrow.scale * np.linalg.norm(arrow.values, axis=1)
    size = make_film([Motion((Part(plant, t, q),))]).actors[0].size
    assert lengths[-1] == pytest.approx(0.3 * size, rel=1e-6)
    assert lengths[0] == pytest.approx(0.45 * size, rel=1e-6)
