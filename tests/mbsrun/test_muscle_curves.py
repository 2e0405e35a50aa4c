"""Curves of Millard's and Thelen's muscles: files of OpenSim against OpenSim's numbers, which ship in tests/reference.

`python -m tests.mbsrun.test_muscle_curves` writes the numbers anew, where `tests.opensim` finds OpenSim.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from sympy import Float

from mbsgen.errors import InputError
from mbsgen.expressions import FLOATS, Expression, Number, Program, evaluate, parse, substitute
from mbsgen.importing import Choices, import_model
from mbsgen.model.reader import read_model
from mbsgen.model.smooth import bezier
from mbsgen.model.writer import write_model
from mbsrun import load
from mbsrun.external import load_on_demand
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.statement import read_problem
from mbsrun.simulation.drive import ARRAYS
from tests.mbsgen.importing.osim_files import save
from tests.mbsrun.muscle_files import ELASTIC, MUSCLES, STRENGTH, TENDON, ask_opensim, draw, write_file
from tests.shipped import FOLDER

Array = NDArray[np.float64]
REFERENCE = Path(__file__).parents[1] / "reference" / "opensim_muscle_curves.json"
NEAR = 1e-9  # over the strength: OpenSim solves for velocities to 1e-10 of it, and for points of curves to 1e-13


@pytest.fixture(autouse=True)
def compiler(requires: Callable[[str], str]) -> None:
    requires("cc")


def find_misses(folder: Path, states: list[dict[str, Any]], expected: list[dict[str, dict[str, float]]]) -> Array:
    """Return the largest differences of each muscle, over the strength: of tension, and of equilibrium."""
    model = import_model(save(folder, write_file()), Choices()).model
    (folder / "cart.yaml").write_text(write_model(model), "utf-8")
    cart = load(folder / "cart.yaml")
    q, qd = (np.array([[x[key]] for x in states]) for key in ("q", "qd"))
    texts = {x.name: x.muscle for x in cart.manifest.appearance.elements}  # type: ignore[union-attr]
    given: dict[str, Array] = {"length": q[:, 0], "rate": qd[:, 0]}
    for name in MUSCLES:
        given[name] = np.array([x["activations"][name] for x in states])
    for name in ELASTIC:
        along = np.array([x[name]["fibre"] * x[name]["cosine"] for x in expected])
        given[f"{name}_tendon"] = (q[:, 0] - along - TENDON) / (TENDON * MUSCLES[name][3])
    w = np.column_stack([given[name] for name in cart.manifest.signals])
    tensions = cart.tensions(q=q, qd=qd, w=w)["tension"].reshape(len(q), -1)
    misses = np.zeros((len(MUSCLES), 2))
    for k, (name, (*_, strain)) in enumerate(MUSCLES.items()):
        wanted = {key: np.array([x[name][key] for x in expected]) for key in ("tension", "fibre", "cosine", "speed")}
        misses[k, 0] = np.abs(tensions[:, cart.manifest.elements.index(name)] - wanted["tension"]).max() / STRENGTH
        if name in ELASTIC:
            own = {**given, "fibre_length": wanted["fibre"], "fibre_cosine": wanted["cosine"]}
            own["tendon_state_rate"] = (qd[:, 0] - wanted["speed"]) / (TENDON * strain)
            equation = Program((parse(texts[name].equilibrium),), ARRAYS)  # type: ignore[union-attr]
            misses[k, 1] = np.abs(equation.evaluate(own)[0]).max()
    return misses


def test_muscles_are_opensims(tmp_path: Path) -> None:
    """Tensions, and the equilibrium of elastic tendons at OpenSim's velocities of fibres, at random states."""
    reference = json.loads(REFERENCE.read_text("utf-8"))
    misses = find_misses(tmp_path, draw(len(reference)), reference)
    assert misses.max() < NEAR, misses


def test_the_reference_is_what_opensim_computes(tmp_path: Path) -> None:
    states = draw(1000)
    misses = find_misses(tmp_path, states, ask_opensim(states))
    assert misses.max() < NEAR, misses


def test_curves_join_lines_smoothly() -> None:
    """A corner is the curve of its six control points, in 50 digits."""
    rng, expression = np.random.default_rng(2), parse("bezier(x, 1, 2, xc, yc, 4, 7, c)")
    for _ in range(3):
        part, yc, c = rng.uniform(0.02, 0.98), rng.uniform(-3, 9), rng.uniform(0.1, 0.9)
        own: dict[str, Expression] = {"xc": Number(1 + 3 * part), "yc": Number(yc), "c": Number(c)}
        corner = substitute(expression, own)
        for x in (1.0, 1.0001, *rng.uniform(1, 4, 2), 4.0):
            found = evaluate(corner, {"x": x}, FLOATS)
            wanted = bezier(Float(x), 1, 2, Float(1 + 3 * part), Float(yc), 4, 7, Float(c)).evalf(50)
            assert abs(found - float(wanted)) < 1e-12 * (1 + abs(yc)), (x, own)


def test_numbers_of_curves_are_written_and_read_again(tmp_path: Path) -> None:
    model = import_model(save(tmp_path, write_file()), Choices()).model
    (tmp_path / "cart.yaml").write_text(write_model(model), "utf-8")
    assert read_model(tmp_path / "cart.yaml") == model


FAULTS = {
    "type: millard": ("type: milard", "milard"),
    "greatest: 1.6": ("greatest: 0.9", "greatest: found 0.9; give more than 1"),
    "shortest: 0.4": ("shortest: 0.8", "transition: found 0.7; give a number between 0.8 and 0.95"),
    "passive_slope: 4": ("passive_slope: 1", "passive_slope: found 1; give more than 1.667"),
    "tendon_slope: 30": ("tendon_slope: 3", "tendon_slope: found 3; give more than 16.67"),
    "tendon_toe: 0.4": ("tendon_toe: 1.4", "tendon_toe: found 1.4; give a number between 0 and 1"),
    "passive_shape: 4": ("passive_shape: 0", "passive_shape: found 0; give more than 0"),
    "reach: 0.9": ("reach: 0.5", "reach: found 0.5; give a number between 0.625 and 1"),
}


@pytest.mark.parametrize("old", FAULTS)
def test_a_curve_that_cannot_be_is_one_clear_error(old: str, tmp_path: Path) -> None:
    model = import_model(save(tmp_path, write_file()), Choices()).model
    text, (new, wanted) = write_model(model), FAULTS[old]
    head, found, tail = text.rpartition(old)
    assert found
    (tmp_path / "cart.yaml").write_text(f"{head}{new}{tail}", "utf-8")
    with pytest.raises(InputError) as caught:
        read_model(tmp_path / "cart.yaml")
    assert wanted in str(caught.value)
    assert "cart.yaml:" in str(caught.value)


def test_a_mass_hangs_on_a_muscle_of_millard(tmp_path: Path) -> None:
    """The problem of models/moco with these curves: the elastic tendon is in equilibrium at all points."""
    text = (FOLDER / "moco" / "hanging.yaml").read_text("utf-8")
    old = "elastic: {state: tendon, strain: 0.1}"
    assert old in text
    new = f"damping: 0.1, passive: 0.7, {old}, curves: {{type: millard}}"
    (tmp_path / "hanging.yaml").write_text(text.replace(old, new), "utf-8")
    (tmp_path / "hanging.ocp.yaml").write_text((FOLDER / "moco" / "hanging.ocp.yaml").read_text("utf-8"), "utf-8")
    found = solve(*read_problem(tmp_path / "hanging.ocp.yaml", load_on_demand))
    assert isinstance(found, Solution), found
    assert found.violation.constraints < 1e-6


if __name__ == "__main__":
    REFERENCE.write_text(json.dumps(ask_opensim(draw(20))) + "\n", "utf-8")
