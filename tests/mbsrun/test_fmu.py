"""Functional mock-up units, read, compiled and simulated by FMPy, beside `mbsrun simulate` and the kernels."""

from __future__ import annotations

import io
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from click.testing import CliRunner
from fmpy.build import build_platform_binary
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu

from mbsgen.pipeline import OptionError, Options, make
from mbsgen.targets.fmu import list_functions
from mbsgen.targets.fmu.variables import write_document
from mbsrun.cli import cli
from mbsrun.external import Mechanism, load
from mbsrun.fmu import write_fmu
from mbsrun.models import Extent
from tests.shipped import FOLDER

LOOPS = Extent(("loops", "loop_rates"), 0)
RUNTIME = """\
name: "a <b> & c"
gravity: [0, 0, -9.81]
parameters:
  m: {value: 2, kind: runtime}
bodies:
  - name: hull
    joint: {type: free, actuated: true}
    mass: m
    com: [0, 0, -0.1]
    inertia: [0.1, 0.2, 0.25]
  - name: rod
    parent: hull
    joint: {name: pin, type: revolute, axis: y, position: [0.1, 0, 0], damping: 0.02}
    mass: 0.5
    com: [0, 0, -0.5]
    inertia: [0.05, 0.05, 0]
wrenches:
  - {name: gust, body: rod, position: [0, 0, -1], force: input, moment: input}
frames:
  - {name: tip, body: rod, position: [0, 0, -1]}
"""


CRANE = """\
name: crane
gravity: [0, 0, -9.81]
bodies:
  - name: trolley
    joint: {name: drive, type: prismatic, axis: x, actuated: true}
    mass: 3
  - name: load
    parent: trolley
    joint: {name: swing, type: revolute, axis: y, actuated: false}
    mass: 1
    com: [0, 0, -1]
driven: [swing]
"""


def _write(model: Path, out: Path, **options: Any) -> tuple[Mechanism, Path]:
    needed, optional = list_functions()
    kernels = load(model, extent=Extent(needed, 1, optional=optional))
    return kernels, write_fmu(kernels, out / f"unit{options.get('fmi', '')}.fmu", **options)


@contextmanager
def _open(unit: Path, folder: Path) -> Iterator[tuple[Any, Mapping[str, int]]]:
    description = fmpy.read_model_description(unit)
    fmpy.extract(unit, folder)
    slave = {"2.0": FMU2Slave, "3.0": FMU3Slave}[description.fmiVersion](
        guid=description.guid,
        unzipDirectory=str(folder),
        modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName="one",
    )
    slave.instantiate()
    yield slave, {v.name: v.valueReference for v in description.modelVariables}
    slave.freeInstance()


@pytest.fixture(scope="module")
def hull(tmp_path_factory: pytest.TempPathFactory) -> tuple[Mechanism, Path]:
    folder = tmp_path_factory.mktemp("hull")
    (folder / "hull.yaml").write_text(RUNTIME, encoding="utf-8")
    (folder / "heavy.yaml").write_text(RUNTIME.replace("value: 2", "value: 3.5"), encoding="utf-8")
    return _write(folder / "hull.yaml", folder)


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory: pytest.TempPathFactory) -> tuple[Mechanism, Path]:
    return _write(FOLDER / "double_pendulum.yaml", tmp_path_factory.mktemp("pendulum"))


@pytest.fixture(scope="module")
def linkage(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _write(FOLDER / "four_bar.yaml", tmp_path_factory.mktemp("linkage"), fmi="2.0")[1]


def test_units_are_valid(hull: tuple[Mechanism, Path], pendulum: tuple[Mechanism, Path], linkage: Path) -> None:
    for unit in (hull[1], pendulum[1], linkage):
        assert validate_fmu(str(unit)) == []


Case = tuple[Path, Path, Mapping[str, float], Sequence[str]]


@pytest.fixture(params=["tree", "quaternions and a parameter", "loop"])
def case(request: pytest.FixtureRequest) -> Case:
    """A unit, its model, where the unit starts, and the same for the simulator."""
    if request.param == "tree":
        unit = request.getfixturevalue("pendulum")[1]
        return unit, FOLDER / "double_pendulum.yaml", {"q_q1": 0.5}, ["--pose", "q1=0.5"]
    if request.param == "loop":
        unit, options = request.getfixturevalue("linkage"), ["--velocity", "motor=2", "--loops", "projection"]
        return unit, FOLDER / "four_bar.yaml", {"qd_motor": 2.0}, options
    unit = request.getfixturevalue("hull")[1]
    return unit, unit.parent / "heavy.yaml", {"m": 3.5, "q_pin": 0.4}, ["--pose", "pin=0.4"]


def test_co_simulation_is_the_simulators_motion(case: Case, tmp_path: Path) -> None:
    unit, model, start, options = case
    names = [v.name for v in fmpy.read_model_description(unit).modelVariables if v.name.startswith(("q_", "qd_"))]
    ends = {"stop_time": 0.5, "output_interval": 0.1}
    found = fmpy.simulate_fmu(str(unit), fmi_type="CoSimulation", start_values=start, output=names, **ends)
    command = ["simulate", str(model), "--duration", "0.5", "--method", "rk4", *options, "-o", str(tmp_path / "out")]
    assert CliRunner().invoke(cli, command, catch_exceptions=False).exit_code == 0
    last = (tmp_path / "out" / "trajectory.csv").read_text(encoding="utf-8").splitlines()[-1].split(",")
    assert list(found[-1]) == pytest.approx([float(x) for x in last[: 1 + len(names)]], rel=1e-12, abs=1e-12)


def test_model_exchange_returns_to_closed_loops(linkage: Path) -> None:
    """The integrator lets the loops open; after a step the unit says so, and an event closes them."""
    options: dict[str, Any] = {"stop_time": 0.5, "output": ["q_motor", "q_pin", "q_swing"]}
    free, kept = (
        fmpy.simulate_fmu(str(linkage), fmi_type=kind, **options, relative_tolerance=1e-6)[-1]
        for kind in ("CoSimulation", "ModelExchange")
    )
    gap = load(FOLDER / "four_bar.yaml", extent=LOOPS)("loops", q=list(kept)[1:])["gap"]
    assert np.abs(gap).max() < 1e-8
    assert list(kept) == pytest.approx(list(free), abs=1e-2)


def test_joints_that_follow_start_where_the_loop_puts_them(linkage: Path, tmp_path: Path) -> None:
    with _open(linkage, tmp_path) as (slave, places):
        slave.setupExperiment()
        slave.enterInitializationMode()
        slave.setReal([places["q_motor"], places["qd_motor"]], [1.2, 3.0])
        slave.exitInitializationMode()
        found = slave.getReal([places[f"{kind}_{x}"] for kind in ("q", "qd") for x in ("motor", "pin", "swing")])
    kernels = load(FOLDER / "four_bar.yaml", extent=LOOPS)
    assert found[0] == 1.2
    assert found[3] == pytest.approx(3.0, rel=1e-15)
    assert kernels("loops", q=found[:3])["gap"] == pytest.approx([0, 0], abs=1e-15)
    assert kernels("loop_rates", q=found[:3], qd=found[3:])["hd"] == pytest.approx([0, 0], abs=1e-14)


def test_derivatives_in_fmi_2_are_differences(linkage: Path, tmp_path: Path) -> None:
    """Of accelerations and outputs, which depend on a state that leaves the closed loops too."""
    with _open(linkage, tmp_path) as (slave, places):
        slave.setupExperiment()
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        unknowns = [places[name] for name in ("der(qd_motor)", "der(qd_swing)", "tracer.x", "der(q_pin)")]
        knowns = [places[name] for name in ("q_pin", "qd_motor", "qd_pin", "u_motor")]
        direction, ends = [0.3, -0.2, 0.5, 0.7], []
        found = slave.getDirectionalDerivative(unknowns, knowns, direction)
        start = slave.getReal(knowns)
        for h in (1e-5, -1e-5):
            slave.setReal(knowns, [x + h * d for x, d in zip(start, direction, strict=True)])
            ends.append(np.array(slave.getReal(unknowns)))
    assert found == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-8)


def test_model_exchange_is_the_same_motion(pendulum: tuple[Mechanism, Path]) -> None:
    ends = [
        fmpy.simulate_fmu(
            str(pendulum[1]),
            fmi_type=kind,
            stop_time=1,
            start_values={"q_q1": 0.5},
            output=["q_q1", "q_q2"],
            relative_tolerance=1e-10,
        )[-1]
        for kind in ("ModelExchange", "CoSimulation")
    ]
    assert list(ends[0]) == pytest.approx(list(ends[1]), abs=1e-7)


def test_sources_alone_are_compiled_by_others(tmp_path: Path) -> None:
    _, unit = _write(FOLDER / "pendulum.yaml", tmp_path, compiled=False)
    assert not [name for name in zipfile.ZipFile(unit).namelist() if name.startswith("binaries")]
    folder = Path(fmpy.extract(unit, tmp_path / "unzipped"))
    build_platform_binary(folder)
    found = fmpy.simulate_fmu(str(folder), stop_time=0.1)
    assert np.isfinite(found["time"]).all()


def test_derivatives_are_the_kernels(hull: tuple[Mechanism, Path], tmp_path: Path) -> None:
    """Of all rates, accelerations and outputs, by all states and inputs, forward and adjoint; a tuned parameter too."""
    kernels, unit = hull
    rng = np.random.default_rng(4)
    q, qd = rng.normal(size=8), rng.normal(size=7)
    with _open(unit, tmp_path) as (slave, places):
        slave.enterInitializationMode()
        inputs = [name for name in places if name.startswith("u_")]
        u = rng.normal(size=len(inputs))
        tuned = kernels.with_parameters(m=3.5)
        states = [name for name in places if name.startswith(("q_", "qd_"))]
        slave.getFloat64([places[f"der({states[-1]})"]])  # computed with the mass of the model
        for name, value in zip((*states, *inputs, "m"), (*q, *qd, *u, 3.5), strict=True):
            slave.setFloat64([places[name]], [value])
        force, wrench = u[:7], u[7:]
        arguments: dict[str, Any] = {"q": q, "qd": qd, "u": force, "w": wrench}
        unknowns = [places[f"der({name})"] for name in states] + [places[f"tip.{axis}"] for axis in "xyz"]
        values = slave.getFloat64(unknowns)
        expected = np.concatenate(
            (
                tuned("rates", q=q, qd=qd)["rate"],
                tuned("exp2", **arguments)["qdd"],
                tuned("sensors", q=q)["position"].T[0],
            )
        )
        assert values == pytest.approx(expected, abs=1e-13)
        assert slave.getFloat64([places[name] for name in states]) == pytest.approx([*q, *qd])
        slopes = _stack(tuned, arguments)
        knowns = [places[name] for name in (*states, *inputs)]
        seed, adjoint = rng.normal(size=len(knowns)), rng.normal(size=len(unknowns))
        forward = slave.getDirectionalDerivative(unknowns, knowns, list(seed))
        backward = slave.getAdjointDerivative(unknowns, knowns, list(adjoint), len(knowns))
        assert forward == pytest.approx(slopes @ seed, abs=1e-12)
        assert backward == pytest.approx(adjoint @ slopes, abs=1e-12)


def _stack(kernels: Mechanism, arguments: Mapping[str, Any]) -> np.ndarray:
    """Return the derivatives of (rates, accelerations, places) by (q, qd, u, w), from the kernels."""
    blocks = kernels("jac_exp2", **arguments) | kernels("jac_rates", q=arguments["q"], qd=arguments["qd"])
    blocks |= kernels("jac_sensors", q=arguments["q"])
    columns = [("q", 8), ("qd", 7), ("u", 7), ("w", 6)]
    rows = [("rate", 8), ("qdd", 7), ("position", 3)]
    return np.block([[blocks.get(f"jac_{of}_{by}", np.zeros((m, n))) for by, n in columns] for of, m in rows])


def test_a_state_can_be_kept_and_taken_up_again(pendulum: tuple[Mechanism, Path], tmp_path: Path) -> None:
    with _open(pendulum[1], tmp_path) as (slave, places):
        slave.enterInitializationMode()
        slave.setFloat64([places["q_q1"]], [0.4])
        slave.exitInitializationMode()
        slave.doStep(0.0, 0.1)
        kept = slave.getFMUState()
        written = slave.serializeFMUState(kept)
        slave.doStep(0.1, 0.1)
        later = slave.getFloat64([places["q_q1"], places["qd_q2"]])
        assert slave.getFloat64([places["time"]]) == pytest.approx([0.2])
        slave.setFMUState(slave.deserializeFMUState(written))
        assert slave.getFloat64([places["time"]]) == pytest.approx([0.1])
        slave.doStep(0.1, 0.1)
        assert slave.getFloat64([places["q_q1"], places["qd_q2"]]) == later
        with pytest.raises(Exception, match=r"SetFloat64"):
            slave.setFloat64([places["der(q_q1)"]], [1.0])
        with pytest.raises(Exception, match=r"DoStep"):
            slave.doStep(0.2, float("nan"))
        slave.freeFMUState(kept)


def test_names_of_any_text_are_xml() -> None:
    name = "\ufffe <\"&'> \u00e9"
    read = ET.fromstring(write_document(ET.Element("a", name=name)).encode())
    assert read.get("name") == name.replace("\ufffe", "\ufffd")


def test_equal_models_give_equal_bytes(tmp_path: Path) -> None:
    (tmp_path / "again").mkdir()
    first, second = (
        _write(FOLDER / "pendulum.yaml", folder, compiled=False)[1] for folder in (tmp_path, tmp_path / "again")
    )
    assert first.read_bytes() == second.read_bytes()


def test_driven_joints_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "crane.yaml").write_text(CRANE, encoding="utf-8")
    run = CliRunner().invoke(cli, ["fmu", "crane.yaml"])
    assert run.exit_code != 0
    assert "driven joints" in str(run.exception)
    assert not (tmp_path / "crane.fmu").exists()


def test_mbsgen_packs_the_same_sources(tmp_path: Path) -> None:
    """Of the functions that a unit calls; the tables that they are called by are the same, so all else is."""
    product = make(FOLDER / "pendulum.yaml", Options(targets=("fmu",), functions=("exp2", "sensors"), derivatives=1))
    kernels, unit = _write(FOLDER / "pendulum.yaml", tmp_path, compiled=False)
    (packed,) = product.packages.values()
    ours, theirs = zipfile.ZipFile(io.BytesIO(packed)), zipfile.ZipFile(unit)
    assert sorted(ours.namelist()) == sorted(theirs.namelist())
    assert kernels.manifest.model_hash == product.manifest.model_hash
    assert packed == unit.read_bytes()


def test_a_unit_without_accelerations_is_refused() -> None:
    with pytest.raises(OptionError, match="calls exp2 and its first derivatives"):
        make(FOLDER / "pendulum.yaml", Options(targets=("fmu",), functions=("impl",), derivatives=1))
