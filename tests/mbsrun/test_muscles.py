"""Muscles of model files: against OpenSim's numbers, which ship in tests/reference; equilibrium, files and faults.

`python -m tests.mbsrun.test_muscles` writes the numbers anew, where `tests.opensim` finds OpenSim.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen.errors import InputError
from mbsgen.expressions import FLOATS, evaluate, parse
from mbsgen.model.model import Model
from mbsgen.model.reader import read_model
from mbsgen.model.writer import write_model
from mbsrun import load
from mbsrun.models import Extent
from tests.opensim import ask
from tests.shipped import FOLDER

LEG = FOLDER / "muscles" / "leg.yaml"
REFERENCE = Path(__file__).parents[1] / "reference" / "opensim_muscles.json"
COMPARED = Extent(("lengths", "stretches", "tensions"), 1, values=("stretches", "tensions"))
ROUNDING = 1e-12  # relative: sums of some numbers of the same size, and exponentials of arguments up to 10


@pytest.fixture(autouse=True)
def compiler(requires: Callable[[str], str]) -> None:
    requires("cc")


def draw(count: int) -> list[dict[str, Any]]:
    """Draw states at which each muscle is between half and twice as long as its fibres."""
    rng, found = np.random.default_rng(3), []
    for _ in range(count):
        q = rng.uniform((-0.4, -1.5), (1.5, -0.1))
        sizes = {"qd": (-3, 3, 2), "activations": (0.01, 1, 3), "forces": (0.05, 1.2, 2), "rates": (-5, 5, 2)}
        drawn = {key: rng.uniform(low, high, size).tolist() for key, (low, high, size) in sizes.items()}
        found.append({"q": q.tolist(), **drawn})
    return found


def ask_opensim(states: list[dict[str, Any]]) -> list[list[dict[str, Any]]]:
    found: list[list[dict[str, Any]]] = json.loads(ask(Path(__file__).with_name("muscle_peer.py"), json.dumps(states)))
    return found


def find_misses(states: list[dict[str, Any]], expected: list[list[dict[str, Any]]]) -> dict[str, float]:
    """Return the largest differences, relative to the largest number of a kind; of equilibrium, to each number."""
    leg = load(LEG, extent=COMPARED)
    arrays = {key: np.array([x[key] for x in states]) for key in states[0]}
    q, qd, a, s = (arrays[key] for key in ("q", "qd", "activations", "forces"))
    assert leg.manifest.signals == ("rectus", "vastus_tendon", "sartorius_tendon")
    found: dict[str, NDArray[np.float64]] = {
        "length": leg.lengths(q=q)["length"],
        "rate": leg.stretches(q=q, qd=qd)["stretch"],
        "tension": leg.tensions(q=q, qd=qd, w=np.column_stack((a[:, :1], s)))["tension"],
        "arms": -leg.jac_lengths(q=q)["jac_length_q"],
    }
    texts = leg.manifest.appearance
    assert texts is not None
    for key in ("fibre", "cosine", "equilibrium"):
        found[key] = np.zeros((len(q), 3))
        for k, element in enumerate(texts.elements):
            text = getattr(element.muscle, key)
            for i in range(len(q)) if text else ():
                own = {"length": found["length"][i, k], "rate": found["rate"][i, k], element.name: a[i, k]}
                if k:
                    own |= {f"{element.name}_tendon": s[i, k - 1], "tendon_state_rate": arrays["rates"][i, k - 1]}
                if key == "equilibrium":
                    own |= {"fibre_length": found["fibre"][i, k], "fibre_cosine": found["cosine"][i, k]}
                found[key][i, k] = evaluate(parse(text), own, FLOATS)
    misses = {}
    for key, values in found.items():
        wanted = np.array([[muscle[key] for muscle in state] for state in expected])
        scale = np.abs(wanted) + 1 if key == "equilibrium" else np.abs(wanted).max()
        misses[key] = float((np.abs(values.reshape(wanted.shape) - wanted) / scale).max())
    return misses


def test_muscles_are_opensims() -> None:
    """Lengths, rates, tensions, fibres, arms, and residuals of elastic tendons at random states."""
    reference = json.loads(REFERENCE.read_text("utf-8"))
    misses = find_misses(draw(len(reference)), reference)
    assert max(misses.values()) < ROUNDING, misses


def test_the_reference_is_what_opensim_computes() -> None:
    states = draw(200)
    misses = find_misses(states, ask_opensim(states))
    assert max(misses.values()) < ROUNDING, misses


def test_a_tendon_settles_where_its_equilibrium_is_0() -> None:
    """The rate of a tendon's force that `settling` gives makes the equation of `equilibrium` hold."""
    texts = load(LEG, extent=COMPARED).manifest.appearance
    assert texts is not None
    for element, slack in zip(texts.elements[1:], (0.2, 0.11), strict=True):
        assert element.muscle is not None
        fibre = {"vastus": 0.107, "sartorius": 0.403}[element.name]
        for stretch in (0.7, 1.0, 1.2):
            for force in (0.3, 0.6):
                own = {"length": slack * 1.02 + fibre * stretch, "rate": 0.1, element.name: 0.5}
                own[f"{element.name}_tendon"] = force
                for key, text in (("fibre_length", element.muscle.fibre), ("fibre_cosine", element.muscle.cosine)):
                    own[key] = evaluate(parse(text), own, FLOATS)
                own["tendon_state_rate"] = evaluate(parse(element.muscle.settling), own, FLOATS)
                assert abs(evaluate(parse(element.muscle.equilibrium), own, FLOATS)) < ROUNDING


def read(folder: Path, text: str) -> Model:
    (folder / "leg.yaml").write_text(text, "utf-8")
    return read_model(folder / "leg.yaml")


def test_muscles_are_written_and_read_again(tmp_path: Path) -> None:
    model = read_model(LEG)
    assert read(tmp_path, write_model(model)) == model


FAULTS = {
    "strength": ("strength: 156", "strength: -156", "strength: found -156; give more than 0"),
    "angle": ("10 deg", "10", "pennation: an angle of 10 rad; give less than a quarter turn; 15 deg has a unit"),
    "activation": ("activation: rectus", "activation: rektus", "rektus"),
    "spring": ("type: muscle\n    from: {body: base, position: [0.02", "type: muscle\n    stiffness: 3\n    from: "
               "{body: base, position: [0.02", "stiffness: a stiffness beside the law of a muscle"),
    "bare": ("    muscle: {strength: 1169", "    # {strength: 1169", "strength: found 0; give more than 0"),
    "body": ("via: [{body: thigh", "via: [{body: tigh", 'there is no body "tigh"; did you mean "thigh"?'),
    "coordinate": ("-0.3, 0.01]}", "-0.3, 0.01], while: {number: q_kne, range: [-1, 0]}}", "coordinate \"q_kne\"; "
                   "did you mean q_knee?"),
    "range": ("-0.3, 0.01]}", "-0.3, 0.01], while: {number: q_knee, range: [1, 0]}}", "a range from 1 to 0; swap them"),
    "end": ("-0.05, 0]}", "-0.05, 0], while: {number: q_knee, range: [-1, 0]}}", "give such a point under via"),
    "shift": ("-0.05, 0]}", "-0.05, 0], shift: [0.1*qd_knee, 0, 0]}", "a point that moves with qd_knee; use q_NAME"),
    "unknown": ("tendon: 0.37,", "tendom: 0.37,", "tendom"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_a_faulty_muscle_is_one_clear_error(fault: str, tmp_path: Path) -> None:
    old, new, wanted = FAULTS[fault]
    text = LEG.read_text("utf-8")
    assert old in text
    with pytest.raises(InputError) as caught:
        read(tmp_path, text.replace(old, new))
    assert wanted in str(caught.value)
    assert "leg.yaml:" in str(caught.value)


if __name__ == "__main__":
    REFERENCE.write_text(json.dumps(ask_opensim(draw(20))) + "\n", "utf-8")
