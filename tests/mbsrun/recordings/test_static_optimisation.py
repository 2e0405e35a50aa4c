"""`mbsrun so` and `mbsrun id`: against OpenSim's tools, whose numbers ship in tests/reference; optimality; refusals.

`python -m tests.mbsrun.recordings.test_static_optimisation` writes the numbers anew, where `tests.opensim` finds it.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsrun.commands.recorded import write_storage
from mbsrun.recordings import read_recording
from tests.mbsgen.importing.osim_files import Link, write_model
from tests.mbsgen.importing.osim_muscle_files import fixed, line, numbers
from tests.opensim import ask

Run = Callable[..., tuple[object, str, str]]
Array = NDArray[np.float64]
REFERENCE = Path(__file__).parents[2] / "reference" / "opensim_static.json"
KEPT = slice(15, 30)  # samples that are far from the ends, where OpenSim's splines have other third derivatives
LOADS = ("--open", "shank", "--forces", "loads.mot", "--wrench", "shank=ground_force_v,ground_force_p,ground_torque_")
MUSCLES = ("rectus", "biceps", "vastus", "short")


def write_leg(folder: Path, *, elastic: bool = False) -> None:
    """Write a plane leg with four muscles without pennation, a motion, and a force on its shank."""
    plane = {"outer": ("0 -0.4 0", "0 0 0"), "inner": ("0 0 0", "0 0 0")}
    links = (Link("thigh", coordinates=("hip",), **plane), Link("shank", "PinJoint", "thigh", ("knee",), **plane))
    front, back = fixed("c", "shank", "0.05 -0.05 0.02"), fixed("c", "shank", "-0.04 -0.06 0.02")
    rows = (
        (
            "rectus",
            fixed("a", "ground", "0.05 0 0.02") + fixed("b", "thigh", "0.06 -0.35 0.02") + front,
            700,
            0.2,
            0.55,
        ),
        ("biceps", fixed("a", "ground", "-0.06 0 0.02") + back, 900, 0.2, 0.6),
        ("vastus", fixed("a", "thigh", "0.04 -0.15 0.02") + front, 1500, 0.12, 0.2),
        ("short", fixed("a", "thigh", "-0.03 -0.2 0.02") + back, 500, 0.15, 0.1),
    )
    more = numbers(ignore_tendon_compliance=not elastic, ignore_passive_fiber_force=True, fiber_damping=0)
    keys = ("max_isometric_force", "optimal_fiber_length", "tendon_slack_length")
    forces = "".join(
        line("DeGrooteFregly2016Muscle", name, path, numbers(**dict(zip(keys, given, strict=True))) + more)
        for name, path, *given in rows
    )
    (folder / "leg.osim").write_text(write_model(links, forces=forces), "utf-8")
    t = np.linspace(0, 0.45, 46)
    hip, knee = 0.3 - 0.8 * t + 1.1 * t**2 + 0.6 * t**3, -0.4 + 0.9 * t - 2.1 * t**2 + 0.8 * t**3
    write_storage(folder / "motion.mot", ("hip", "knee"), t, np.column_stack((hip, knee)))
    force, point, torque = (5 + 3 * t, 20 + 40 * t, 1), (0.1 * t, 0.1 * t - 0.8, 0.02), (0, 0, 0.5)
    names = [f"ground_{part}{axis}" for part in ("force_v", "force_p", "torque_") for axis in "xyz"]
    loads = np.column_stack([x + 0 * t for x in (*force, *point, *torque)])
    write_storage(folder / "loads.mot", names, t, loads)


def ask_opensim(folder: Path) -> dict[str, Any]:
    """Return OpenSim's forces and activations at the samples that are kept."""
    given = {"model": "leg.osim", "motion": "motion.mot", "loads": "loads.mot"}
    paths = {key: str((folder / name).resolve()) for key, name in given.items()}
    text = json.dumps({**paths, "body": "shank", "reserve": 2.0})
    found = json.loads(ask(Path(__file__).parents[1] / "static_peer.py", text, folder))  # where its log stays
    return {key: {name: x[KEPT] for name, x in part.items()} for key, part in found.items()}


def find_misses(run: Run, wanted: dict[str, Any]) -> dict[str, float]:
    """Return the largest differences of forces [N m] and activations."""
    code, _, err = run("id", "leg.osim", "motion.mot", *LOADS, "--without-muscles", "-o", "forces")
    assert code == 0, err
    code, _, err = run("so", "leg.osim", "motion.mot", *LOADS, "--reserve", "2", "--no-passive", "-o", "shares")
    assert code == 0, err
    forces, shares = read_recording(Path("forces/forces.csv")), read_recording(Path("shares/activations.csv"))
    pairs = [(forces.column(f"rest[{name}]"), wanted["forces"][f"{name}_moment"]) for name in ("hip", "knee")]
    found = {"forces": max(float(np.abs(x[KEPT] - y).max()) for x, y in pairs)}
    pairs = [(shares.column(f"activation[{name}]"), wanted["activations"][name]) for name in MUSCLES]
    pairs += [(shares.column(f"reserve[{k}]") / 2, wanted["activations"][f"reserve_{k}"]) for k in ("hip", "knee")]
    return found | {"activations": max(float(np.abs(x[KEPT] - y).max()) for x, y in pairs)}


def test_forces_and_activations_are_opensims(run: Run) -> None:
    """To the digits that OpenSim's files have, and the tolerance of its search."""
    write_leg(Path())
    misses = find_misses(run, json.loads(REFERENCE.read_text("utf-8")))
    assert misses["forces"] < 1e-7, misses
    assert misses["activations"] < 1e-6, misses


def test_the_reference_is_what_opensim_computes(run: Run) -> None:
    write_leg(Path())
    misses = find_misses(run, ask_opensim(Path()))
    assert max(misses.values()) < 1e-6, misses


def test_muscles_and_reserves_give_the_forces(run: Run) -> None:
    """Passive fibres pull too; elastic tendons are rigid on request; bounds hold."""
    write_leg(Path(), elastic=True)
    rigid = (*LOADS, "--rigid-tendons")
    code, out, err = run("so", "leg.osim", "motion.mot", *rigid, "--most", "0.1", "--least", "0.01", "-o", "shares")
    assert code == 0, err
    assert "activation[vastus]" in out
    shares = read_recording(Path("shares/activations.csv"))
    activations = np.array([shares.column(f"activation[{name}]") for name in MUSCLES])
    assert activations.min() >= 0.01
    assert activations.max() == pytest.approx(0.1)
    summary = json.loads(Path("shares/activations.json").read_text("utf-8"))
    assert summary["parts"]["activation[vastus]"]["largest"] == pytest.approx(0.1)
    assert sorted(x.name for x in Path("shares").iterdir()) == [f"activations.{k}" for k in ("csv", "json", "png")]


def test_what_has_no_static_optimum_is_refused(run: Run) -> None:
    write_leg(Path(), elastic=True)
    code, _, err = run("so", "leg.osim", "motion.mot")
    assert code == 2
    assert "elastic tendon of rectus is not given; import the file with --rigid-tendons, or leave elastic out" in err
    code, _, err = run("so", "leg.osim", "motion.mot", "--least", "2")
    assert (code, "--least 0 or more, and below --most" in err) == (2, True)
    text = Path("leg.osim").read_text("utf-8")
    Path("bare.osim").write_text(text[: text.index("<ForceSet")] + text[text.index("</ForceSet>") + 11 :], "utf-8")
    code, _, err = run("so", "bare.osim", "motion.mot")
    assert (code, "leg has no muscles; give it some, with type: muscle under forces" in err) == (2, True)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        write_leg(Path(name))
        REFERENCE.write_text(json.dumps(ask_opensim(Path(name))) + "\n", "utf-8")
