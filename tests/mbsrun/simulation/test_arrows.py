"""Arrows of forces follow parameters, signals, time and state: compared with the power that kernels compute."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from mbsrun import Mechanism
from mbsrun.animation import Motion, Part, make_film
from mbsrun.animation.film import Force
from mbsrun.animation.forces import find_loads
from mbsrun.appearance import complete_appearance
from mbsrun.cli import cli
from mbsrun.external import load
from mbsrun.models import Extent
from mbsrun.skeleton import place

DRIVEN = """name: driven
gravity: [0, 0, -9.81]
parameters:
  k: {value: 50, kind: runtime}
  l: {value: 0.3, kind: runtime}
  r: {value: 0.1, kind: differentiated}
  turn: {value: 0.2, kind: runtime}
  c: 2
  d: c*l
bodies:
  - {name: crate, joint: {type: floating}, mass: 2, inertia: [0.02, 0.02, 0.02]}
  - name: bob
    parent: crate
    joint: {type: revolute, axis: y, position: [0.1, 0, d]}
    mass: 1
    com: [0, 0, 0.1]
    inertia: [0.01, 0.01, 0.01]
  - {name: plate, parent: bob, mass: 1,
     joint: {type: fixed, position: [0, 0, sqrt(l)], orientation: [{axis: x, angle: turn}, {axis: z, angle: 0.3}]}}
  - name: tail
    parent: crate
    joint: {type: revolute, axis: x, follows: {joint: bob, ratio: 1.5, offset: 0.2}}
    mass: 0.3
    com: [0, 0, 0.2]
    inertia: [0.01, 0.01, 0.01]
frames:
  - {name: tip, body: plate, position: [0, 0.1, l/2], sensor: false}
signals: [act]
"""
FORCES = """forces:
  - {name: strut, from: {body: base, position: [1, 0, c]}, to: {body: plate, position: [r, 0, l**2]},
     stiffness: 2*k, rest: 0.2*l, damping: 3*c}
  - {name: rope, type: cable, from: {body: bob}, to: {body: base, position: [l, 0.3, 0]}, stiffness: 70 + k, rest: r,
     width: 0.05, dissipation: 0.4*l, force: 2*k*r}
  - {name: muscle, from: {body: base, position: [1, 0, 1]}, to: {body: plate, position: [0.2, 0, 0]},
     force: "k*act*exp(-length) - c*rate + min(q_tail, 1) + vz_tip*t"}
wrenches:
  - {name: drag, body: bob, position: [0, l, 0.4],
     force: ["-k*qd_bob*abs(qd_tail)", "softplus(x_tip, 0.1)", "max(t, 2)"],
     moment: [0, "sin(t)*c", "step(q_crate_x, r)"]}
  - {name: thrust, body: plate, position: [0, 0, 0.4], frame: body, force: [l, "-qd_bob", 3], moment: [k/10, 0, 0]}
contacts:
  - {name: ball, body: bob, position: [0, 0, l], stiffness: 90*k, exponent: 1, width: r, dissipation: l,
     friction: {coefficient: l, speed: r}}
"""
CHANGED = {"k": 80.0, "l": 0.45, "r": 0.17, "turn": -0.3}


def read(folder: Path, name: str, text: str, functions: tuple[str, ...] = ("impl", "frames"), **more: Any) -> Mechanism:
    path = folder / f"{name}.yaml"
    path.write_text(text)
    return load(path, extent=Extent(functions, derivatives=0, **more))


def find_power(plant: Mechanism, q: Any, qd: Any, signals: dict[str, Any], zero: float = 1e-6) -> Any:
    """Add the power of all loads: F.v + M.OM, by differences of the poses."""
    now, after, before = (place(plant, q + step * qd) for step in (0.0, zero, -zero))
    total = np.zeros(len(q))
    for found in find_loads(plant, q, qd, signals):
        i, at = found.foot.frame, np.array(found.foot.at)
        if found.kind is Force.FORCE:
            a, b = (x.p[:, :, i] + x.R[:, :, 3 * i : 3 * i + 3] @ at for x in (after, before))
            total += np.einsum("ki,ki->k", found.values, (a - b) / (2 * zero))
        else:
            spin = (after.R - before.R)[:, :, 3 * i : 3 * i + 3] / (2 * zero)
            spin = spin @ now.R[:, :, 3 * i : 3 * i + 3].swapaxes(1, 2)
            OM = np.stack((spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]), axis=1)
            total += np.einsum("ki,ki->k", found.values, OM)
    return total


@pytest.mark.parametrize("changed", [{}, CHANGED], ids=["as written", "changed"])
def test_power_of_arrows_is_the_power_of_the_kernels_forces(tmp_path: Path, changed: dict[str, float]) -> None:
    """qd.(Phi without forces - Phi with them) = sum of F.v and M.OM, with any parameters, signals and times."""
    driven = read(tmp_path, "driven", DRIVEN + FORCES).with_parameters(**changed)
    mere = read(tmp_path, "mere", DRIVEN.replace("signals: [act]\n", "")).with_parameters(**changed)
    rng = np.random.default_rng(5)
    q, qd = 0.2 * rng.normal(size=(2, 12, len(driven.manifest.coordinates)))
    act, t = rng.uniform(size=12), 4 * rng.uniform(size=12)
    state: dict[str, Any] = {
        "q": q,
        "qd": qd,
        "qdd": np.zeros_like(q),
        "u": np.zeros((12, len(driven.manifest.actuated))),
    }
    forced = driven("impl", **state, w=np.stack((act, t), axis=1))["Phi"]
    power = np.einsum("ki,ki->k", qd, mere("impl", **state)["Phi"] - forced)
    assert np.abs(power).max() > 1
    assert find_power(driven, q, qd, {"act": act, "t": t}) == pytest.approx(power, abs=1e-6)


def test_numbers_by_their_paths_move_arrows(tmp_path: Path) -> None:
    """The same with every number of the model a parameter by its path, as the plants of `track` are."""
    plain = FORCES.replace("stiffness: 2*k", "stiffness: 90")
    driven, mere = (
        read(tmp_path, name, text, runtime=True)
        for name, text in (("driven", DRIVEN + plain), ("mere", DRIVEN.replace("signals: [act]\n", "")))
    )
    changes = {"forces.strut.stiffness": 200.0, "wrenches.thrust.force.z": 7.0}
    driven = driven.with_parameters(**changes)
    q = np.full((1, len(driven.manifest.coordinates)), 0.1)
    qd = 2 * q
    state: dict[str, Any] = {"q": q, "qd": qd, "qdd": 0 * q, "u": np.zeros((1, len(driven.manifest.actuated)))}
    forced = driven("impl", **state, w=np.array([[0.5, 1.0]]))["Phi"]
    power = np.einsum("ki,ki->k", qd, mere("impl", **state)["Phi"] - forced)
    found = find_power(driven, q, qd, {"act": np.array([0.5]), "t": np.array([1.0])})
    assert found == pytest.approx(power, abs=1e-6)


SPRUNG = """name: sprung
gravity: [0, 0, -9.81]
parameters: {k: {value: 50, kind: runtime}}
bodies: [{name: bob, joint: {name: z, type: prismatic, axis: z, actuated: false}, mass: 1}]
forces: [{name: spring, from: {body: base, position: [0, 0, 1]}, to: {body: bob}, stiffness: k, rest: 0.4}]
wrenches: [{name: lift, body: bob, force: [0, 0, 5]}]
"""


def animate(*arguments: str) -> str:
    """Run `mbsrun animate sprung.yaml`, and return the page, or the refusal."""
    run = CliRunner().invoke(cli, ["animate", "sprung.yaml", *arguments, "-o", "page.html"])
    return Path("page.html").read_text() if run.exit_code == 0 else str(run.exception)


def test_a_motion_is_animated_with_its_own_parameters(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The page of a simulated motion is the page with its parameters; a given one goes before the motion's."""
    monkeypatch.chdir(tmp_path)
    Path("sprung.yaml").write_text(SPRUNG)
    simulate = ["simulate", "sprung.yaml", "--duration", "0.2", "--parameter", "k=80", "-o", "moved"]
    assert CliRunner().invoke(cli, simulate).exit_code == 0
    own, table = animate("moved"), Path("moved/trajectory.csv").read_text()
    assert own == animate("moved=moved/trajectory.csv")
    assert own != animate("moved", "--parameter", "k=50")
    Path("moved/simulation.json").unlink()
    assert own == animate("moved", "--parameter", "k=80")
    assert own != animate("moved")
    Path("tracked").mkdir()
    Path("tracked/track.csv").write_text(re.sub(r" \[[^]]*\]", "", table))  # tracks have no units
    summary = Path("tracked/summary.json")
    summary.write_text('{"parameters": {"forces.spring.rest": 0.1}}')
    stretched = animate("tracked")
    assert "</html>" in stretched
    summary.write_text('{"parameters": {"forces.spring.rest": 0.4}}')
    assert stretched != animate("tracked")
    summary.write_text('{"parameters": {"forces.sprung.rest": 0.4}}')
    assert 'parameters: it was made with other values of "forces.sprung.rest"' in animate("tracked")
    summary.write_text("[]")
    assert "tracked/summary.json: it is no summary of a motion" in animate("tracked")


def test_an_arrow_without_a_value_is_left_out(tmp_path: Path) -> None:
    """The exact force where there is one, at the film's pictures; none where a number has no value."""
    plant = read(tmp_path, "sprung", SPRUNG.replace("stiffness: k", "stiffness: sqrt(k)"), ("frames",))
    t, q = np.array([0.0, 1.0]), np.zeros((2, 1))
    spring, lift = make_film([Motion((Part(plant.with_parameters(k=16.0), t, q),))]).tracks[0].arrows
    assert lift.values[0] == pytest.approx([0, 0, 5])
    assert spring.values[0] == pytest.approx([0, 0, 4 * 0.6])
    appearance = complete_appearance(plant.with_parameters(k=-1.0))
    assert appearance is not None
    assert appearance.elements[0].law is not None
    assert np.isnan(appearance.elements[0].law.stiffness)
    (lift,) = make_film([Motion((Part(plant.with_parameters(k=-1.0), t, q),))]).tracks[0].arrows
    assert lift.values[0] == pytest.approx([0, 0, 5])


TURNED = """name: turned
gravity: [0, 0, 0]
parameters: {turn: {value: 0.2, kind: runtime}, l: 0.3}
bodies:
  - {name: arm, joint: {name: hinge, type: revolute, axis: [1, 0, 2]}, mass: 1, inertia: [0.1, 0.1, 0.1]}
  - {name: hand, parent: arm, mass: 1,
     joint: {type: fixed, position: [0, 0, l], orientation: [{axis: x, angle: ANGLE}, {axis: z, angle: 0.7}]}}
frames:
  - {name: foot, body: hand, position: [0.1, 0, 0.2]}
wrenches:
  - {name: free, body: arm, frame: body, force: input}
  - {name: push, body: hand, frame: body, position: [0.1, 0, 0.2], force: input, moment: input}
  - {name: wind, body: hand, frame: base, position: [0.1, 0, 0.2], force: input}
"""


def turn(axis: tuple[float, float, float], angle: float) -> Any:
    """Return the rotation about an axis, by Rodrigues' formula."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


@pytest.mark.parametrize(("text", "angle"), [("1.1", 1.1), ("turn", 0.2), ("turn", -0.6)])
def test_open_wrenches_have_the_axes_of_their_bodies(tmp_path: Path, text: str, angle: float) -> None:
    """A body that is fixed to another one moves in its frame; components along its own axes are turned there."""
    plant = read(tmp_path, "turned", TURNED.replace("ANGLE", text), ("impl", "frames", "sensors"))
    plant = plant.with_parameters(turn=angle if text == "turn" else 0.2)
    rng = np.random.default_rng(3)
    t, q = np.array([0.0, 1.0]), np.array([[0.4], [0.9]])
    w = np.repeat(rng.normal(size=(1, 12)), 2, axis=0)
    film = make_film([Motion((Part(plant, t, q, w=w),))])
    arrows, R = film.tracks[0].arrows, film.tracks[0].R
    angles = np.interp(film.times, t, q[:, 0])
    arm = np.stack([turn((1, 0, 2), x) for x in angles])
    hand = arm @ turn((1, 0, 0), angle) @ turn((0, 0, 1), 0.7)
    base = np.broadcast_to(np.eye(3), arm.shape)
    expected = [A @ w[0, k : k + 3] for A, k in ((arm, 0), (hand, 3), (hand, 6), (base, 9))]
    for arrow, vectors in zip(arrows, expected, strict=True):
        shown = arrow.values if arrow.in_base else np.einsum("kij,kj->ki", R[:, arrow.foot.frame], arrow.values)
        assert shown == pytest.approx(vectors, abs=1e-12)
    foot = film.tracks[0].p[0, arrows[1].foot.frame] + R[0, arrows[1].foot.frame] @ arrows[1].foot.at
    assert foot == pytest.approx(plant.sensors(q=q[0])["position"][:, 0], abs=1e-12)
    power = arrow_power(plant, q[0], expected, film.tracks[0].p[0, 0])
    at_rest = {"q": q[0], "qd": [0.0], "qdd": [0.0], "u": [0.0]}
    forces = plant.impl(**at_rest, w=np.zeros(12))["Phi"] - plant.impl(**at_rest, w=w[0])["Phi"]
    assert power == pytest.approx(forces, abs=1e-12)


def arrow_power(plant: Mechanism, q: Any, vectors: list[Any], origin: Any) -> Any:
    """Return the moment of the arrows about the hinge: a force at the arm's origin has none."""
    axis = np.array([1, 0, 2]) / np.sqrt(5)
    lever = plant.sensors(q=q)["position"][:, 0] - origin
    _, push, moment, wind = (x[0] for x in vectors)
    return axis @ (np.cross(lever, push + wind) + moment)
