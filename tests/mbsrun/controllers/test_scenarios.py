"""Scenarios in a controller: copies of a mechanism in one model, whose first inputs are equal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import mbsrun
from mbsrun.cli import cli
from mbsrun.optimal.control import OptimalControl
from mbsrun.optimal.phases import SolvedPhases

LEAN, BOUND = 0.3, 20.0
CART = """\
  - {{name: cart{k}, joint: {{type: prismatic, axis: x, limits: [-2, 2]}}, mass: 1}}
  - name: pole{k}
    parent: cart{k}
    joint: {{type: revolute, axis: -y, actuated: false}}
    mass: {mass}
    com: [0, 0, -0.5]
"""
TERMS = ("q_cart{k}**2", "(q_pole{k} - pi)**2", "qd_cart{k}**2 + qd_pole{k}**2")
WEIGHTS = (1, 10, 0.1)


def write_model(folder: Path, names: dict[str, str]) -> Path:
    """Write as many cart-poles as there are names; each has a mass of its pole."""
    masses = ", ".join(f"{mass}: {{value: 0.3, kind: runtime}}" for mass in names.values())
    bodies = "".join(CART.format(k=k, mass=mass) for k, mass in names.items())
    file = folder / f"carts{len(names)}.yaml"
    file.write_text(
        f"name: carts{len(names)}\ngravity: [0, 0, -9.81]\nparameters: {{{masses}}}\nbodies:\n{bodies}",
        encoding="utf-8",
    )
    return file


def state(model: Path, names: dict[str, str], lean: float) -> OptimalControl:
    """State the problem to catch all poles, with the sum of the costs."""
    running = [
        {"expression": " + ".join(term.format(k=k) for k in names), "weight": weight}
        for term, weight in zip(TERMS, WEIGHTS, strict=True)
    ]
    return mbsrun.problem(
        model,
        horizon=1.5,
        intervals=15,
        scheme="legendre",
        degree=2,
        cost={"inputs": 0.01, "running": running},
        start={"pose": {f"pole{k}": np.pi + lean for k in names}},
        bounds={"inputs": [-BOUND, BOUND]},
    )


def solve_scenarios(folder: Path, masses: tuple[float, float], lean: float) -> tuple[float, float]:
    """Return the cost and the first input of one cart-pole's scenarios."""
    one = state(write_model(folder, {"": "mp"}), {"": "mp"}, lean)
    found = one.with_scenarios({"parameters.mp": list(masses)}).solve(check=False)
    assert isinstance(found, SolvedPhases)
    return found.cost, found.unknowns["first_u_cart"]


def test_copies_with_one_first_input_are_scenarios(tmp_path: Path) -> None:
    """The controller has the cost and the first input of scenarios, also after its masses and its start change."""
    names = {"0": "light", "1": "heavy"}
    write_model(tmp_path, names)
    lines = [
        "model: carts2.yaml",
        "horizon: 1.5",
        "intervals: 15",
        "scheme: legendre",
        "degree: 2",
        "cost:",
        "  inputs: 0.01",
        "  running:",
        *(
            f"    - {{expression: {' + '.join(term.format(k=k) for k in names)}, weight: {weight}}}"
            for term, weight in zip(TERMS, WEIGHTS, strict=True)
        ),
        f"start: {{pose: {{pole0: pi + {LEAN}, pole1: pi + {LEAN}}}}}",
        f"bounds: {{inputs: [-{BOUND}, {BOUND}]}}",
        "parameters: {light: 0.2, heavy: 0.5}",
        "constraints: [{expression: u_cart0 - u_cart1, range: [0, 0], at: start}]",
    ]
    (tmp_path / "robust.ocp.yaml").write_text("\n".join(lines), encoding="utf-8")
    made = CliRunner().invoke(cli, ["controller", str(tmp_path / "robust.ocp.yaml"), "-o", str(tmp_path / "out")])
    assert made.exit_code == 0, made.output
    controller = mbsrun.controller(tmp_path / "out")
    for masses, lean in (((0.2, 0.5), LEAN), ((0.1, 0.7), -0.2)):
        controller.data["parameters"][:] = masses
        controller.data["start_q"][[1, 3]] = np.pi + lean
        cost, first = solve_scenarios(tmp_path, masses, lean)
        answer = controller.solve()
        assert answer.cost == pytest.approx(cost, rel=1e-6)
        assert controller.plan().inputs[0] == pytest.approx([first, first], abs=1e-4)
        measured = [0.0, np.pi + lean, 0.0, np.pi + lean, 0.0, 0.0, 0.0, 0.0]
        for _ in range(3):
            assert controller.prepare().status == "prepared"
            inputs, step = controller.feedback(measured)
            assert step.status == "stepped"
        assert inputs == pytest.approx([first, first], abs=2e-2)  # by the barrier
        assert inputs[0] == pytest.approx(inputs[1], abs=1e-8)
