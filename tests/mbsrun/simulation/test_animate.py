"""`mbsrun animate`, and the pictures that it writes without a browser."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

from mbsgen.errors import InputError
from mbsgen.manifest import Frame, Point
from mbsrun import Mechanism
from mbsrun.animation import Motion, Part, Wanted, make_film, render_parts, write_page
from mbsrun.animation.actors import fit_solid
from mbsrun.animation.files import Size, write_gif
from mbsrun.animation.film import Actor, Arrow, Film, Force, Kind, Layer, Solid, Track
from mbsrun.animation.raster import PAPER, draw_film, look, rasterise, read_color
from mbsrun.commands.animate import animate_command

ROOT = Path(__file__).parents[3]
MODEL = ROOT / "models" / "pendulum.yaml"
STANDING = np.eye(3)[None, None]


def make_still(*solids: Solid, arrows: tuple[Arrow, ...] = ()) -> Film:
    """Return a film of one frame that stands at the origin."""
    actor = Actor("still", "#000000", (Frame(name="a", parent=-1, sensor=False),), solids, (), frozenset({0}))
    track = Track(np.zeros((1, 1, 3)), STANDING, arrows)
    corners = tuple((x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0))
    return Film("", np.zeros(1), (actor,), (track,), (0, 0, 1), (-1, -1, -1), (1, 1, 1), corners, 0.05)


@pytest.mark.parametrize(
    ("edges", "kind"), [((0.3, 0.2, 0.1), Kind.BOX), ((0.4, 0.4, 0.4), Kind.BOX), ((0.2, 0.2, 0.7), Kind.CYLINDER)]
)
def test_a_solid_has_the_mass_and_inertia_of_its_body(edges: tuple[float, float, float], kind: Kind) -> None:
    """The moments of a box and of a cylinder, turned by C about z: the same edges, and along the same axes."""
    a, b, c = edges
    m, (ca, sa) = 2.5, (np.cos(0.4), np.sin(0.4))
    box = m / 12 * np.array([b * b + c * c, a * a + c * c, a * a + b * b])
    cylinder = m / 12 * np.array([0.75 * a * a + c * c, 0.75 * a * a + c * c, 1.5 * a * a])
    moments = cylinder if kind is Kind.CYLINDER else box
    C = np.array([[ca, -sa, 0], [sa, ca, 0], [0, 0, 1]])
    tensor = C @ np.diag(moments) @ C.T
    fit = fit_solid(m, (tensor[0, 0], tensor[1, 1], tensor[2, 2], tensor[0, 1], tensor[0, 2], tensor[1, 2]))
    assert fit.kind is kind
    assert np.linalg.det(fit.axes) == pytest.approx(1)
    spread, wanted = (x @ np.diag(np.square(s)) @ x.T for x, s in ((fit.axes, fit.size), (C, np.array(edges))))
    assert spread == pytest.approx(wanted, abs=1e-12)


def test_a_pixel_shows_the_nearest_triangle() -> None:
    """Two triangles over the picture, one at distance 2, the other from 1 to 3 along its upper side.

    1/distance is linear: w0 + w1/3 = (w0 + w1)/2 three quarters of the way. In row 5 the sides are at -27.8 and 127.8.
    """
    places = np.array([[[-50.0, -50], [150, -50], [50, 200]]] * 2)
    far = np.array([[2.0, 2, 2], [1.0, 3, 2]])
    depth = np.full((40, 100), np.inf)
    found = rasterise(places, far, depth)
    assert found is not None
    row, column, triangle, weights = found
    shown = np.zeros((40, 100), dtype=int)
    shown[row, column] = triangle
    assert len(row) == 4000
    assert (shown[5, :88] == 1).all()
    assert (shown[5, 90:] == 0).all()
    assert weights.sum(axis=1) == pytest.approx(1)
    assert depth[row, column] == pytest.approx((weights * far[triangle]).sum(axis=1))


def test_a_ball_is_drawn_where_it_is() -> None:
    """The disc of a ball of radius r at distance d has r f / sqrt(d^2 - r^2) pixels of radius; 2 % is the shape's."""
    ball = Solid(Layer.SOLIDS, 0, Kind.ELLIPSOID, (1.0, 1.0, 1.0), "#0072b2")
    film = make_still(ball)
    (picture,) = draw_film(film, 200, 160)
    camera = look(film, 200, 160)
    d = float(np.linalg.norm(camera.eye))
    radius = 0.5 * camera.scale / np.sqrt(d * d - 0.25)
    blue = picture[..., 2].astype(int) - picture[..., 0] > 40
    assert blue.sum() == pytest.approx(np.pi * radius**2, rel=0.03)
    rows, columns = np.nonzero(blue)
    assert (columns.mean() + 0.5, rows.mean() + 0.5) == pytest.approx((100, 80), abs=0.6)
    assert (picture[-1, -1] == np.rint(PAPER * 255)).all()


def test_arrows_stand_in_front() -> None:
    """A force within a ball is seen."""
    ball = Solid(Layer.SOLIDS, 0, Kind.ELLIPSOID, (1.5, 1.5, 1.5), "#0072b2")
    force = Arrow(Force.FORCE, Point(frame=0, at=(0.0, 0.0, 0.0)), True, np.array([[0.0, 0.0, 0.5]]))
    plain, pointed = (next(draw_film(make_still(ball, arrows=x), 240, 180)).astype(int) for x in ((), (force,)))
    red = [int((x[..., 0] > x[..., 2] + 60).sum()) for x in (plain, pointed)]
    assert red[0] == 0
    assert red[1] > 20


def swing(name: str, pendulum: Mechanism, turns: float) -> Motion:
    t = np.linspace(0, 1, 11)
    return Motion((Part(pendulum, t, turns * np.sin(3 * t)[:, None], u=np.ones((11, 1))),), name)


def test_motions_of_different_length_share_a_page(pendulum: Mechanism) -> None:
    """A motion stands after its end, and has no arrows there."""
    t = np.array([0.0, 2.0])
    still = Motion((Part(pendulum, t, np.zeros((2, 1))),), "still")
    film = make_film([swing("swing", pendulum, 1.0), still], Wanted("both", is_apart=True))
    after = film.times > 1
    assert [actor.name for actor in film.actors] == ["swing", "still"]
    (arrow,) = film.tracks[0].arrows
    assert not arrow.values[after].any()
    assert (arrow.values[~after, 1] == 1).all()
    assert np.ptp(film.tracks[0].p[after], axis=0).max() == 0
    assert film.actors[0].color != film.actors[1].color


def test_mechanisms_that_follow_each_other_are_shown_one_by_one(
    pendulum: Mechanism, double_pendulum: Mechanism
) -> None:
    """The second one's lower rod has another colour, which the pictures of its time alone hold."""
    second = Part(double_pendulum, np.array([1.0, 2.0]), np.ones((2, 2)), name="double")
    first = Part(pendulum, np.array([0.0, 1.0]), np.ones((2, 1)), name="single")
    film = make_film([Motion((first,)), Motion((second,))], Wanted(is_sequence=True, rate=2.0))
    assert film.parts == (("single", 0.0), ("double", 1.0))
    lower = read_color(film.actors[1].solids[1].color)
    assert film.actors[0].solids[0].color == film.actors[1].solids[0].color
    counts = []
    for picture in draw_film(film, 160, 120):
        hue = picture / np.maximum(picture.sum(axis=2, keepdims=True, dtype=float), 1)
        counts.append(int((np.abs(hue - lower / lower.sum()).max(axis=2) < 0.03).sum()))
    assert [count > 20 for count in counts] == [False, False, True, True, True]
    page = json.loads(
        re.findall(r'application/json"[^>]*>(.*?)</script>', render_parts([first, second], "two"), re.S)[0]
    )
    assert [course["shown"] for course in page["courses"]] == [[0.0, 1.0], [1.0, 3.0]]


def test_the_page_draws_in_a_browser(pendulum: Mechanism, tmp_path: Path, requires: Callable[[str], str]) -> None:
    """In Chromium, without a message on its console; the canvas holds the colours of solids and of an arrow."""
    film = make_film([swing("one", pendulum, 1.0), swing("other", pendulum, 0.3)], Wanted("two", is_apart=True))
    text = write_page(film)
    assert text == write_page(film)
    page, picture = tmp_path / "page.html", tmp_path / "page.png"
    page.write_text(text, encoding="utf-8")
    options = ["--headless", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    options += ["--enable-logging=stderr", "--virtual-time-budget=2000", "--window-size=640,480"]
    options += [f"--user-data-dir={tmp_path / 'profile'}", f"--screenshot={picture}"]
    run = subprocess.run(
        [requires("chromium"), *options, page.as_uri()], capture_output=True, text=True, timeout=120, check=True
    )
    assert "CONSOLE" not in run.stderr, run.stderr
    shown = np.asarray(Image.open(picture).convert("RGB")).astype(int)[60:380]
    for color in (*(actor.solids[0].color for actor in film.actors), "#cc79a7"):
        wanted = read_color(color)
        hue = shown / np.maximum(shown.sum(axis=2, keepdims=True), 1)
        assert (np.abs(hue - wanted / wanted.sum()).max(axis=2) < 0.06).sum() > 20, color


def write_motion(folder: Path) -> Path:
    t = np.linspace(0, 0.4, 5)
    path = folder / "swing.csv"
    rows = "".join(f"{x},{np.sin(3 * x)},{3 * np.cos(3 * x)},1.5\n" for x in t)
    path.write_text(f"t,q[q1],qd[q1],u[q1]\n{rows}", encoding="utf-8")
    return path


def test_the_command_writes_each_format(tmp_path: Path, requires: Callable[[str], str]) -> None:
    requires("ffmpeg")
    motion, files = write_motion(tmp_path), [tmp_path / name for name in ("a.html", "a.gif", "b.gif", "a.mp4")]
    options = [x for file in files for x in ("-o", str(file))]
    arguments = [str(MODEL), f"first={motion}", *options, "--size", "64x48", "--rate", "10"]
    run = CliRunner().invoke(animate_command, arguments, catch_exceptions=False)
    assert run.exit_code == 0, run.output
    assert re.search(r'"name": "first"', files[0].read_text(encoding="utf-8"))
    assert files[1].read_bytes() == files[2].read_bytes()
    with Image.open(files[1]) as gif:
        assert (gif.n_frames, gif.size, gif.info["duration"]) == (5, (64, 48), 100)
    assert files[3].read_bytes()[4:8] == b"ftyp"


def test_colours_of_a_gif_are_the_pages(tmp_path: Path) -> None:
    """The background is exact, as a page has it; bodies are near it, in every picture."""
    colors = ("#0072b2", "#e69f00", "#009e73", "#d55e00", "#cc79a7")
    edges = (0.3, 0.3, 0.3)
    balls = [
        Solid(Layer.SOLIDS, 0, Kind.ELLIPSOID, edges, color, (0.4 * k - 0.8, 0, 0)) for k, color in enumerate(colors)
    ]
    film = make_still(*balls)
    write_gif(film, tmp_path / "balls.gif", Size(240, 180), lambda *_: None)
    with Image.open(tmp_path / "balls.gif") as gif:
        found = np.asarray(gif.convert("RGB")).astype(int)
    (drawn,) = draw_film(film, 240, 180)
    assert (found == np.rint(255 * PAPER)).all(axis=2).mean() > 0.5
    assert np.abs(found - drawn.astype(int)).max() <= 24
    assert np.abs(found - drawn.astype(int)).mean() < 0.5


def test_a_picture_is_a_strip_of_frames(tmp_path: Path) -> None:
    """Six pictures, from the first to the last; or pictures at given times, equal to the film's."""
    motion, out = write_motion(tmp_path), tmp_path / "a.png"
    arguments = [str(MODEL), str(motion), "-o", str(out), "--size", "64x48", "--rate", "10"]
    run = CliRunner().invoke(animate_command, arguments, catch_exceptions=False)
    assert run.exit_code == 0, run.output
    with Image.open(out) as strip:
        assert strip.size == (3 * 64 + 8, 2 * 48 + 4)
        first, last = (np.asarray(strip.crop(box)) for box in ((0, 0, 64, 48), (136, 52, 200, 100)))
    for time, expected in ((0, first), (0.4, last)):
        CliRunner().invoke(animate_command, [*arguments, "--at", str(time)], catch_exceptions=False)
        with Image.open(out) as one:
            assert (np.asarray(one) == expected).all()
    content = out.read_bytes()
    CliRunner().invoke(animate_command, [*arguments, "--at", "0.4"], catch_exceptions=False)
    assert out.read_bytes() == content
    for more, finding in ((["--at", "0.6"], "0.6 s is not between 0 and 0.4 s"), (["--at", "x"], "--at")):
        run = CliRunner().invoke(animate_command, [*arguments, *more])
        assert run.exit_code == 2
        assert finding in run.output
    run = CliRunner().invoke(animate_command, [str(MODEL), str(motion), "-o", str(tmp_path / "a.gif"), "--at", "0"])
    assert run.exit_code == 2
    assert "it chooses the times of a .png" in run.output


class Nowhere:
    """Stands for `shutil` on a machine without other programs."""

    @staticmethod
    def which(name: str) -> str | None:
        return None if name == "ffmpeg" else name


@pytest.mark.parametrize(
    ("out", "finding"), [("a.avi", "found .avi at the end of its name"), ("a.mp4", "ffmpeg, which writes MP4, is not")]
)
def test_formats_that_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, out: str, finding: str
) -> None:
    monkeypatch.setattr("mbsrun.animation.files.shutil", Nowhere)
    arguments = [str(MODEL), str(write_motion(tmp_path)), "-o", str(tmp_path / out), "--size", "32x32"]
    with pytest.raises(InputError, match=finding):
        CliRunner().invoke(animate_command, arguments, catch_exceptions=False)


@pytest.mark.parametrize(
    ("text", "finding"),
    [("t,q[other]\n0,1\n1,2\n", r'no column is named "q\[q1\]"'), ("t,q[q1]\n0,\n1,\n", "no row holds all coord")],
)
def test_motions_of_other_models_are_refused(tmp_path: Path, text: str, finding: str) -> None:
    (tmp_path / "motion.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=finding):
        CliRunner().invoke(animate_command, [str(MODEL), str(tmp_path)], catch_exceptions=False)
    for other, finding in (("docs", "the folder holds no motion"), ("nowhere", "there is no such file or folder")):
        with pytest.raises(InputError, match=finding):
            CliRunner().invoke(animate_command, [str(MODEL), str(ROOT / other)], catch_exceptions=False)


def test_the_scene_names_shapes_that_the_renderer_knows() -> None:
    """Each kind of solid and line of a film stands in the renderer."""
    script = (ROOT / "templates" / "html" / "renderer.js").read_text(encoding="utf-8")
    for kind in Kind:
        assert f"{kind.value}: () =>" in script
    for layer in Layer:
        assert f"{layer.value}: true" in script
    assert json.dumps("rod") in script
