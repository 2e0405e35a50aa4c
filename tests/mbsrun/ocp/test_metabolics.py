"""Metabolic rates of muscles: against OpenSim's numbers, which ship in tests/reference; and as the cost of a motion.

`python -m tests.mbsrun.ocp.test_metabolics` writes the numbers anew, where `tests.opensim` finds OpenSim.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen.expressions import Name, Program
from mbsgen.importing import Choices, import_model
from mbsgen.model.writer import write_model
from mbsrun import load
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.metabolics import write_rate
from mbsrun.ocp.statement.muscles import name_numbers
from mbsrun.ocp.statement.sections import MetabolicsSection
from mbsrun.ocp.statement.statement import read_problem
from mbsrun.simulation.drive import ARRAYS
from tests.mbsgen.importing.osim_files import save
from tests.mbsrun.muscle_files import ELASTIC, MUSCLES, TENDON, ask_opensim, draw, write_file
from tests.shipped import FOLDER

Array = NDArray[np.float64]
REFERENCE = Path(__file__).parents[2] / "reference" / "opensim_metabolics.json"
NEAR = 1e-8  # over the largest rate: OpenSim solves for velocities to 1e-10 of the strength, of 900 W s/m


@pytest.fixture(autouse=True)
def compiler(requires: Callable[[str], str]) -> None:
    requires("cc")


def draw_driven(count: int) -> list[dict[str, Any]]:
    """Draw states with excitations other than the activations."""
    rng = np.random.default_rng(8)
    return [{**x, "excitations": {name: rng.uniform(0.02, 1) for name in MUSCLES}} for x in draw(count)]


def find_misses(folder: Path, states: list[dict[str, Any]], expected: list[dict[str, dict[str, float]]]) -> Array:
    """Return the largest difference of each muscle and kind, over the largest rate, where fibres do not push."""
    model = import_model(save(folder, write_file()), Choices()).model
    (folder / "cart.yaml").write_text(write_model(model), "utf-8")
    appearance = load(folder / "cart.yaml").manifest.appearance
    assert appearance is not None
    q, qd = (np.array([x[key] for x in states]) for key in ("q", "qd"))
    misses = np.zeros((len(MUSCLES), 2))
    for i, (name, (*_, strain)) in enumerate(MUSCLES.items()):
        fibres = next(x.muscle for x in appearance.elements if x.name == name)
        assert fibres is not None
        assert fibres.contraction is not None
        wanted = {key: np.array([x[name][key] for x in expected]) for key in expected[0][name]}
        known = {f"length_{name}": q, f"rate_{name}": qd, name: np.array([x["activations"][name] for x in states])}
        known["excitation"] = np.array([x["excitations"][name] for x in states])
        if name in ELASTIC:
            known[f"{name}_tendon"] = (q - wanted["fibre"] * wanted["cosine"] - TENDON) / (TENDON * strain)
            known[f"{name}_tendon_rate"] = (qd - wanted["speed"]) / (TENDON * strain)
        for k, kind in enumerate(("plain", "dependent")):
            section = MetabolicsSection(force_dependent=kind == "dependent")
            rate = write_rate(fibres.contraction, Name("excitation"), section)
            tendon = f"{name}_tendon_rate" if name in ELASTIC else None
            found = Program((name_numbers(fibres, name, tendon, rate),), ARRAYS).evaluate(known)[0]
            pulls = wanted["tension"] > 0
            misses[i, k] = np.abs(found - wanted[kind])[pulls].max() / wanted[kind].max()
    return misses


def test_rates_are_opensims(tmp_path: Path) -> None:
    """At random states and excitations, of muscles with rigid and elastic tendons."""
    reference = json.loads(REFERENCE.read_text("utf-8"))
    misses = find_misses(tmp_path, draw_driven(len(reference)), reference)
    assert misses.max() < NEAR, misses


def test_the_reference_is_what_opensim_computes(tmp_path: Path) -> None:
    states = draw_driven(1000)
    misses = find_misses(tmp_path, states, ask_opensim(states))
    assert misses.max() < NEAR, misses


@pytest.mark.parametrize("more", ["weight: 0.01", "weight: 0.01, force_dependent: true"])
def test_a_motion_costs_its_metabolic_rate(more: str, tmp_path: Path) -> None:
    """With more weight, the least sum of effort and rate has no less effort, and no larger rate."""
    model = (FOLDER / "muscles" / "arm.yaml").read_text("utf-8")
    (tmp_path / "arm.yaml").write_text(model, "utf-8")
    head = "model: arm.yaml\nhorizon: 0.6\nintervals: 10\nscheme: radau\ndegree: 3\ninputs: polynomial\n"
    rest = "start: {pose: {shoulder: 0.1, elbow: 0.2}}\nend: {pose: {shoulder: 0.9, elbow: 1.2}, velocity: zero}\n"
    efforts, energies = [], []
    for weight in (more.replace("0.01", "0.0001"), more):
        muscles = f"muscles: {{rise: 0.04, fall: 0.04, start: 0.05, metabolics: {{{weight}}}}}"
        text = f"{head}{muscles}\n{rest}cost: {{inputs: 0}}\n"
        (tmp_path / "lift.ocp.yaml").write_text(text, "utf-8")
        found = solve(*read_problem(tmp_path / "lift.ocp.yaml", load))
        assert isinstance(found, Solution), found
        terms = dict(found.cost.terms)
        efforts.append(sum(x for key, x in terms.items() if key.endswith("_excitation**2")))
        energies.append(sum(x for key, x in terms.items() if key.startswith("metabolics ")))
    assert efforts[1] > efforts[0]
    assert energies[1] / 0.01 < energies[0] / 0.0001


if __name__ == "__main__":
    REFERENCE.write_text(json.dumps(ask_opensim(draw_driven(20))) + "\n", "utf-8")
