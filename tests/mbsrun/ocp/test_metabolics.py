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
from mbsrun.external import load_on_demand
from mbsrun.metabolics import Metabolism, name_numbers, write_rate
from mbsrun.models import Extent
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solution.table import measure
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.statement import read_problem
from mbsrun.quantities import ARRAYS, Added, list_quantities
from mbsrun.results import Numbers
from tests.mbsgen.importing.osim_files import save
from tests.mbsrun.muscle_files import ELASTIC, MUSCLES, TENDON, ask_opensim, draw, write_file
from tests.shipped import FOLDER

Array = NDArray[np.float64]
REFERENCE = Path(__file__).parents[2] / "reference" / "opensim_metabolics.json"
PLAIN = Extent(derivatives=0)
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
    appearance = load(folder / "cart.yaml", extent=PLAIN).manifest.appearance
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
            section = Metabolism(force_dependent=kind == "dependent")
            rate = write_rate(fibres.contraction, Name("excitation"), section)
            tendon = Name(f"{name}_tendon_rate") if name in ELASTIC else None
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


def test_rates_are_results_of_a_motion(tmp_path: Path) -> None:
    """OpenSim's rates by name; their sum has 1.2 W/kg of the body at rest, OpenSim's basal rate."""
    reference = json.loads(REFERENCE.read_text("utf-8"))
    states = draw_driven(len(reference))
    model = import_model(save(tmp_path, write_file()), Choices()).model
    (tmp_path / "cart.yaml").write_text(write_model(model), "utf-8")
    cart = load(tmp_path / "cart.yaml", extent=PLAIN)
    added = Added(
        states=ELASTIC, controls=(*(f"{x}_excitation" for x in MUSCLES), *(f"{x}_tendon_rate" for x in ELASTIC))
    )
    parts = {key: np.array([[x[key]] for x in states]) for key in ("q", "qd")}
    wanted = {x: {key: np.array([row[x][key] for row in reference]) for key in reference[0][x]} for x in MUSCLES}
    tendons = {x: TENDON * MUSCLES[x][-1] for x in ELASTIC}
    known = {name: np.array([x["activations"][name] for x in states]) for name in MUSCLES}
    known |= {
        f"{x}_tendon": (parts["q"][:, 0] - wanted[x]["fibre"] * wanted[x]["cosine"] - TENDON) / stretched
        for x, stretched in tendons.items()
    }
    parts["w"] = np.column_stack([known[name] for name in cart.manifest.signals])
    rates = [(parts["qd"][:, 0] - wanted[x]["speed"]) / stretched for x, stretched in tendons.items()]
    parts["states"] = np.column_stack([known[name] for name in ELASTIC])
    parts["controls"] = np.column_stack([*([x["excitations"][name] for x in states] for name in MUSCLES), *rates])
    numbers = Numbers(cart, list_quantities(cart.manifest, added), parts)
    total = np.zeros(len(states))
    for name in MUSCLES:
        found, pulls = numbers[f"metabolic_{name}"], wanted[name]["tension"] > 0
        assert np.abs(found - wanted[name]["plain"])[pulls].max() < NEAR * wanted[name]["plain"].max()
        total += found
    assert numbers.unit("metabolic") == numbers.unit(f"metabolic_{name}") == "W"
    assert cart.manifest.appearance is not None
    np.testing.assert_allclose(numbers["basal"], 1.2 * sum(x.mass for x in cart.manifest.appearance.masses), rtol=1e-15)
    np.testing.assert_allclose(numbers["metabolic"], total + numbers["basal"], rtol=1e-14)


def test_rates_of_elastic_tendons_need_their_motion(tmp_path: Path) -> None:
    """Where fibres damp and the motion has no rate of the tendon, the muscle has no value, and neither has the sum."""
    model = import_model(save(tmp_path, write_file()), Choices()).model
    (tmp_path / "cart.yaml").write_text(write_model(model), "utf-8")
    cart = load(tmp_path / "cart.yaml", extent=PLAIN)
    parts = {"q": np.array([[0.3]]), "qd": np.array([[0.0]]), "w": np.full((1, len(cart.manifest.signals)), 0.3)}
    numbers = Numbers(cart, list_quantities(cart.manifest, Added()), parts)
    rates = {name: float(numbers[f"metabolic_{name}"][0]) for name in MUSCLES}
    assert all(np.isfinite(x) for name, x in rates.items() if name not in ELASTIC)
    assert any(np.isnan(x) for x in rates.values())
    assert np.isnan(numbers["metabolic"][0])


def check_results(file: Path, found: Solution, weight: float) -> None:
    """The cost of a muscle is its weight times the integral of its rate, whatever numbers the problem gives."""
    numbers = measure(found, read_problem(file, load_on_demand)[1])
    terms = {key: x for key, x in found.cost.terms if key.startswith("metabolics ")}
    assert len(terms) == 2
    for key, term in terms.items():
        rate = numbers[f"metabolic_{key.removeprefix('metabolics ')}"]
        # the trapezoidal rule on the points of the grid
        assert float(np.trapezoid(rate, numbers["t"])) * weight == pytest.approx(term, rel=0.02)


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
        found = solve(*read_problem(tmp_path / "lift.ocp.yaml", load_on_demand))
        assert isinstance(found, Solution), found
        terms = dict(found.cost.terms)
        check_results(tmp_path / "lift.ocp.yaml", found, float(weight.split(",")[0].split(": ")[1]))
        efforts.append(sum(x for key, x in terms.items() if key.endswith("_excitation**2")))
        energies.append(sum(x for key, x in terms.items() if key.startswith("metabolics ")))
    assert efforts[1] > efforts[0]
    assert energies[1] / 0.01 < energies[0] / 0.0001


if __name__ == "__main__":
    REFERENCE.write_text(json.dumps(ask_opensim(draw_driven(20))) + "\n", "utf-8")
