"""Lines around surfaces: the shortest way by another program, work of the forces, and what is refused.

Lines around ellipsoids and tori are compared with OpenSim's in `tests.mbsgen.importing.test_osim_muscles`.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize

from mbsgen.errors import InputError
from mbsgen.model.reader import read_model
from mbsgen.model.writer import write_model
from mbsrun import load
from mbsrun.external import Mechanism
from mbsrun.models import Extent

Array = NDArray[np.float64]
RADIUS = 0.12
TEXT = """
name: wrapped
gravity: [0, 0, -9.81]
bodies:
  - name: plate
    joint: {name: turn, type: revolute, axis: y, actuated: false}
    mass: 2
    inertia: [0.1, 0.2, 0.3]
  - name: ball
    joint: {type: floating, order: zyx}
    mass: 1
    inertia: [0.01, 0.02, 0.03]
frames: [{name: tip, body: ball, position: [0, 0.1, 0]}]
signals: [pull]
forces:
  - name: cord
    from: {body: base, position: [-0.3, 0.05, 0.1]}
    via: [{body: plate, position: [-0.2, -0.15, 0.05]}]
    to: {body: ball, position: [0, 0.1, 0]}
    wraps:
      - {type: cylinder, body: plate, orientation: [{axis: x, angle: 0.2}], radius: 0.12, between: [2, 3]}
    force: 100*pull
  - name: band
    from: {body: base, position: [-0.3, 0.05, 0.1]}
    to: {body: ball, position: [0, 0.1, 0]}
    wraps: [{type: sphere, body: plate, position: [0.02, 0, 0], radius: 0.12, side: y}]
    force: pull*length
"""


SHAPED = TEXT.replace(
    "- {type: cylinder, body: plate, orientation: [{axis: x, angle: 0.2}], radius: 0.12, between: [2, 3]}",
    "- {type: ellipsoid, body: plate, orientation: [{axis: x, angle: 0.2}], radii: [0.12, 0.1, 0.15], between: [2, 3]}",
).replace(
    "{type: sphere, body: plate, position: [0.02, 0, 0], radius: 0.12, side: y}",
    "{type: torus, body: plate, orientation: [{axis: y, angle: 1.4}], radius: 0.12, tube: 0.03}",
)
# Of lengths alone, derivatives are compared.
COMPARED = Extent(
    ("lengths", "sensors", "stretches", "tensions", "impl"), 1, values=("sensors", "stretches", "tensions", "impl")
)


@pytest.fixture(autouse=True)
def compiler(requires: Callable[[str], str]) -> None:
    requires("cc")


def make(folder: Path, text: str = TEXT, extent: Extent = COMPARED) -> Mechanism:
    path = folder / "wrapped.yaml"
    path.write_text(text, "utf-8")
    return load(path, extent=extent)


def draw(count: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(5)
    q, qd = rng.uniform(-0.4, 0.4, (count, 7)), rng.uniform(-1, 1, (count, 7))
    q[:, 1] += 0.5
    return q, qd


def find_shortest(a: Array, b: Array) -> float:
    """Return the length of the shortest line around a cylinder about z, by a search for the points where it leaves.

    Those are seen from a and b: within an angle of their directions.
    """
    way = np.sign(a[0] * b[1] - a[1] * b[0])
    directions = [np.arctan2(x[1], x[0]) for x in (a, b)]
    between = way * (directions[1] - directions[0]) % (2 * np.pi)

    def measure(x: Array) -> float:
        u, v, z, w = x
        angles = directions[0] + way * u, directions[1] - way * v
        ends = [np.array([RADIUS * np.cos(k), RADIUS * np.sin(k), h]) for k, h in zip(angles, (z, w), strict=True)]
        on = np.hypot(RADIUS * (between - u - v), w - z)
        return float(np.linalg.norm(ends[0] - a) + on + np.linalg.norm(b - ends[1]))

    seen = [np.arccos(RADIUS / np.hypot(*x[:2])) for x in (a, b)]
    bounds = [*((0.0, x) for x in seen), (-5.0, 5.0), (-5.0, 5.0)]
    start = np.array([0.9 * seen[0], 0.9 * seen[1], a[2], b[2]])
    found = minimize(measure, start, method="L-BFGS-B", bounds=bounds, options={"ftol": 1e-15, "gtol": 1e-10})
    return float(found.fun)


def test_a_line_around_a_cylinder_is_the_shortest(tmp_path: Path) -> None:
    """Its length is found by a search over the points where it leaves the cylinder, which is oblique."""
    model = make(tmp_path)
    q, _ = draw(40)
    lengths = model.lengths(q=q)["length"][:, 0]
    ends = model.sensors(q=q)["position"].reshape(-1, 3)
    wrapped = 0
    for row, length, end in zip(q, lengths, ends, strict=True):
        c, s = np.cos(row[0]), np.sin(row[0])
        plate = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        c, s = np.cos(0.2), np.sin(0.2)
        axes = plate @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
        point = plate @ [-0.2, -0.15, 0.05]
        first = np.linalg.norm(point - [-0.3, 0.05, 0.1])
        a, b = axes.T @ point, axes.T @ end
        straight = first + np.linalg.norm(b - a)
        if length > straight + 1e-6:
            wrapped += 1
            assert length - first == pytest.approx(find_shortest(a, b), abs=3e-7)  # where the search ends
        else:
            assert length == pytest.approx(straight, abs=1e-12)
    assert 8 <= wrapped <= 32, "both kinds are drawn"


@pytest.mark.parametrize("text", [TEXT, SHAPED], ids=["round", "shaped"])
def test_forces_do_the_work_of_the_length(text: str, tmp_path: Path) -> None:
    """The rate of a length is its slope times the rates, and the forces of a tension are the slope times it."""
    model = make(tmp_path, text)
    q, qd = draw(40)
    slopes = model.jac_lengths(q=q)["jac_length_q"]
    rates = model.stretches(q=q, qd=qd)["stretch"]
    np.testing.assert_allclose(np.einsum("nij,nj->ni", slopes, qd), rates, atol=1e-12)
    on, off = (model.impl(q=q, qd=qd, qdd=qd, w=np.full((len(q), 1), x))["Phi"] for x in (1.0, 0.0))
    tensions = model.tensions(q=q, qd=qd, w=np.ones((len(q), 1)))["tension"]
    np.testing.assert_allclose(on - off, np.einsum("nij,ni->nj", slopes, tensions), atol=1e-10)


def test_slopes_are_differences_of_lengths(tmp_path: Path) -> None:
    """Around an ellipsoid, whose plane follows from roots and integrals, and in a torus, whose place is a root."""
    model = make(tmp_path, SHAPED)
    q, _ = draw(40)
    lengths, slopes = model.lengths(q=q)["length"], model.jac_lengths(q=q)["jac_length_q"]
    h = 1e-6
    for k, way in enumerate(h * np.eye(7)):
        ends = [model.lengths(q=x)["length"] for x in (q + way, q - way)]
        np.testing.assert_allclose((ends[0] - ends[1]) / (2 * h), slopes[:, :, k], atol=2e-9)  # rounding over h
    straight = make(tmp_path, SHAPED.replace("radii: [0.12, 0.1, 0.15]", "radii: [0.001, 0.001, 0.001]"))
    assert 8 <= np.sum(lengths[:, 0] > straight.lengths(q=q)["length"][:, 0] + 1e-6) <= 32, "both kinds are drawn"


@pytest.mark.parametrize("method", ["hybrid", "midpoint", "axial"])
def test_a_line_around_an_ellipsoid_of_equal_axes_is_one_around_a_sphere(method: str, tmp_path: Path) -> None:
    """Whatever plane is chosen: by symmetry it is the plane of the shortest line, of which a closed form is known."""
    q, _ = draw(40)
    found = []
    for shape in (f"type: ellipsoid, radii: [0.12, 0.12, 0.12], method: {method}", "type: sphere, radius: 0.12"):
        text = TEXT.replace(
            "type: sphere, body: plate, position: [0.02, 0, 0], radius: 0.12, side: y", f"{shape}, body: plate"
        )
        found.append(make(tmp_path, text, Extent(("lengths",), 0)).lengths(q=q)["length"][:, 1])
    np.testing.assert_allclose(*found, rtol=1e-12)


def test_derivatives_are_finite_where_an_end_is_inside(tmp_path: Path) -> None:
    """A line does not wrap then."""
    q = np.zeros((1, 7))
    q[0, 1:4] = 0.02, -0.08, 0.03
    for text in (TEXT, SHAPED):
        model = make(tmp_path, text)
        slopes = model.jac_lengths(q=q)["jac_length_q"]
        np.testing.assert_allclose(slopes @ np.ones(7), model.stretches(q=q, qd=np.ones((1, 7)))["stretch"], atol=1e-12)


@pytest.mark.parametrize("text", [TEXT, SHAPED.replace("0.15],", "0.15], method: axial,")], ids=["round", "shaped"])
def test_surfaces_are_written_and_read_again(text: str, tmp_path: Path) -> None:
    path = tmp_path / "wrapped.yaml"
    path.write_text(text, "utf-8")
    model = read_model(path)
    path.write_text(write_model(model), "utf-8")
    assert read_model(path) == model


FAULTS = {
    "radius": ("radius: 0.12, between", "radius: -0.12, between", "radius: found -0.12; give more than 0"),
    "range": ("between: [2, 3]", "between: [2, 4]", "points 2 and 4 of a line of 3; give the numbers of two"),
    "axis": ("between: [2, 3]", "side: z", "a side along the axis of a cylinder; give x, -x, y or -y"),
    "length": ("side: y", "length: 1", "the length of a sphere; take it away"),
    "body": ("type: sphere, body: plate", "type: sphere, body: plat", 'there is no body "plat"; did you mean "plate"?'),
    "two": ("radius: 0.12, side: y}", "radius: 0.1}, {type: sphere, radius: 0.2}", "two surfaces between the same"),
    "kind": ("type: sphere", "type: cone", "cylinder"),
}  # fmt: skip
SHAPED_FAULTS = {
    "radii": ("0.1, 0.15]", "-0.1, 0.15]", "radii[1]: found -0.1; give more than 0"),
    "tube": ("tube: 0.03", "tube: 0.13", "a tube of 0.13 m in a ring of 0.12 m; give a thinner one"),
    "axis": ("tube: 0.03", "tube: 0.03, side: z", "a side along the axis of a torus; give x, -x, y or -y"),
    "missing": (", tube: 0.03", "", "tube: missing"),
    "method": ("0.15],", "0.15], method: best,", "method"),
    "length": ("0.15],", "0.15], length: 1,", "length"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_faulty_surface_is_one_clear_error(fault: str, tmp_path: Path) -> None:
    check_fault(TEXT, FAULTS[fault], tmp_path)


@pytest.mark.parametrize("fault", SHAPED_FAULTS)
def test_a_faulty_shape_is_one_clear_error(fault: str, tmp_path: Path) -> None:
    check_fault(SHAPED, SHAPED_FAULTS[fault], tmp_path)


def check_fault(text: str, fault: tuple[str, str, str], tmp_path: Path) -> None:
    old, new, wanted = fault
    assert old in text
    (tmp_path / "wrapped.yaml").write_text(text.replace(old, new), "utf-8")
    with pytest.raises(InputError) as caught:
        read_model(tmp_path / "wrapped.yaml")
    assert wanted in str(caught.value)
    assert "wrapped.yaml:" in str(caught.value)
