"""Functional mock-up units, read, compiled and simulated by FMPy, beside `mbsrun simulate` and the kernels."""

from __future__ import annotations

import shutil
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from click.testing import CliRunner
from fmpy.build import build_platform_binary
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu

from mbsrun.cli import cli
from mbsrun.external import Mechanism, load
from mbsrun.fmu import write_fmu
from mbsrun.models import Extent
from tests.shipped import FOLDER

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


def _write(model: Path, out: Path, **options: Any) -> tuple[Mechanism, Path]:
    kernels = load(model, extent=Extent(("exp2", "sensors"), 1, optional=("rates",)))
    return kernels, write_fmu(kernels, out / "unit.fmu", **options)


@contextmanager
def _open(unit: Path, folder: Path) -> Iterator[tuple[FMU3Slave, Mapping[str, int]]]:
    description = fmpy.read_model_description(unit)
    fmpy.extract(unit, folder)
    slave = FMU3Slave(
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
    return _write(folder / "hull.yaml", folder)


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory: pytest.TempPathFactory) -> tuple[Mechanism, Path]:
    return _write(FOLDER / "double_pendulum.yaml", tmp_path_factory.mktemp("pendulum"))


def test_units_are_valid(hull: tuple[Mechanism, Path], pendulum: tuple[Mechanism, Path]) -> None:
    for _, unit in (hull, pendulum):
        assert validate_fmu(str(unit)) == []


def test_co_simulation_is_the_simulators_motion(pendulum: tuple[Mechanism, Path], tmp_path: Path) -> None:
    found = fmpy.simulate_fmu(
        str(pendulum[1]),
        fmi_type="CoSimulation",
        stop_time=1,
        output_interval=0.1,
        start_values={"q_q1": 0.5},
        output=["q_q1", "q_q2", "qd_q1", "qd_q2"],
    )
    command = ["simulate", str(FOLDER / "double_pendulum.yaml"), "--pose", "q1=0.5", "--duration", "1"]
    options = ["--method", "rk4", "--step", "1e-3", "-o", str(tmp_path / "out")]
    assert CliRunner().invoke(cli, [*command, *options], catch_exceptions=False).exit_code == 0
    last = (tmp_path / "out" / "trajectory.csv").read_text(encoding="utf-8").splitlines()[-1].split(",")
    assert list(found[-1]) == pytest.approx([float(x) for x in last[:5]], abs=1e-12)


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
        slave.setFMUState(slave.deserializeFMUState(written))
        slave.doStep(0.1, 0.1)
        assert slave.getFloat64([places["q_q1"], places["qd_q2"]]) == later
        with pytest.raises(Exception, match=r"SetFloat64"):
            slave.setFloat64([places["der(q_q1)"]], [1.0])
        with pytest.raises(Exception, match=r"DoStep"):
            slave.doStep(0.2, float("nan"))
        slave.freeFMUState(kept)


def test_equal_models_give_equal_bytes(tmp_path: Path) -> None:
    (tmp_path / "again").mkdir()
    first, second = (
        _write(FOLDER / "pendulum.yaml", folder, compiled=False)[1] for folder in (tmp_path, tmp_path / "again")
    )
    assert first.read_bytes() == second.read_bytes()


def test_loops_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(FOLDER / "four_bar.yaml", tmp_path)
    run = CliRunner().invoke(cli, ["fmu", "four_bar.yaml"])
    assert run.exit_code != 0
    assert "closed loops" in str(run.exception)
    assert not (tmp_path / "four_bar.fmu").exists()
