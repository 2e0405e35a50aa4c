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

SHAKEN = """\
name: shaken
gravity: [0, 0, -9.81]
bodies:
  - name: rod
    joint: {name: pin, type: revolute, axis: y, actuated: true}
    mass: 0.5
    com: [0, 0, -0.5]
    inertia: [0.05, 0.05, 0]
signals: [act]
wrenches:
  - {name: shake, body: rod, position: [0, 0, -1], force: [3*sin(20*t) + 2*act*q_pin, 0, t**2]}
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


@pytest.fixture(scope="module", params=["2.0", "3.0"])
def shaken(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Mechanism, Path]:
    """A unit whose forces read the time and a signal."""
    folder = tmp_path_factory.mktemp("shaken")
    (folder / "shaken.yaml").write_text(SHAKEN, encoding="utf-8")
    return _write(folder / "shaken.yaml", folder, fmi=request.param)


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


def test_forces_read_the_time_and_signals(shaken: tuple[Mechanism, Path], tmp_path: Path) -> None:
    """By co-simulation as by the simulator, with the same steps; by model exchange the same motion."""
    unit = str(shaken[1])
    variables = {v.name: v for v in fmpy.read_model_description(unit).modelVariables}
    assert variables["u_act"].unit is None
    assert "u_t" not in variables
    assert validate_fmu(unit) == []
    start, names = {"q_pin": 0.3, "u_act": 0.7}, ["q_pin", "qd_pin"]
    for stop, size in ((0.5, 0.1), (0.4, 0.4)):
        ends = {"start_values": start, "output": names, "stop_time": stop, "output_interval": size}
        found = fmpy.simulate_fmu(unit, fmi_type="CoSimulation", **ends)
        settings = f"duration: {stop}\nmethod: rk4\nstart: {{pose: {{pin: 0.3}}}}\nsignals: {{act: 0.7}}\n"
        (tmp_path / "settings.yaml").write_text(settings)
        command = ["simulate", str(shaken[1].parent / "shaken.yaml"), "--settings", str(tmp_path / "settings.yaml")]
        command += ["-o", str(tmp_path / "out")]
        assert CliRunner().invoke(cli, command, catch_exceptions=False).exit_code == 0
        last = (tmp_path / "out" / "trajectory.csv").read_text(encoding="utf-8").splitlines()[-1].split(",")
        assert list(found[-1]) == pytest.approx([float(x) for x in last[:3]], rel=1e-12, abs=1e-12)
        exchanged = fmpy.simulate_fmu(unit, fmi_type="ModelExchange", relative_tolerance=1e-10, **ends)
        assert list(exchanged[-1]) == pytest.approx(list(found[-1]), abs=1e-6)


def test_a_kept_state_has_its_time(shaken: tuple[Mechanism, Path], tmp_path: Path) -> None:
    """Back at the state, two steps lead where they led before; the acceleration is the kernel's at that time."""
    kernels, unit = shaken
    with _open(unit, tmp_path) as (slave, places):
        is_old = fmpy.read_model_description(unit).fmiVersion == "2.0"
        get = slave.getReal if is_old else slave.getFloat64
        if is_old:
            slave.setupExperiment(startTime=1.0)
            slave.enterInitializationMode()
        else:
            slave.enterInitializationMode(startTime=1.0)
        slave.exitInitializationMode()
        slave.doStep(1.0, 0.2)
        q, qd, qdd = get([places[x] for x in ("q_pin", "qd_pin", "der(qd_pin)")])
        expected = kernels("exp2", q=[q], qd=[qd], u=[0.0], w=[0.0, 1.2])["qdd"]
        assert [qdd] == pytest.approx(expected, rel=1e-12)
        state = slave.getFMUState() if not is_old else slave.getFMUstate()
        slave.doStep(1.2, 0.2)
        first = get([places["q_pin"]])
        (slave.setFMUState if not is_old else slave.setFMUstate)(state)
        assert get([places["der(qd_pin)"]]) == [qdd]
        slave.doStep(1.2, 0.2)
        assert get([places["q_pin"]]) == first
        (slave.freeFMUState if not is_old else slave.freeFMUstate)(state)


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


@pytest.fixture(scope="module")
def crane(tmp_path_factory: pytest.TempPathFactory) -> tuple[Mechanism, Path]:
    folder = tmp_path_factory.mktemp("crane")
    (folder / "crane.yaml").write_text(CRANE, encoding="utf-8")
    return _write(folder / "crane.yaml", folder)


@pytest.fixture(scope="module")
def compressor(tmp_path_factory: pytest.TempPathFactory) -> tuple[Mechanism, Path]:
    return _write(FOLDER / "compressor.yaml", tmp_path_factory.mktemp("compressor"), fmi="2.0")


def _simulate(model: Path, out: Path, *options: str) -> tuple[list[str], list[float]]:
    """Return the columns of `mbsrun simulate --method rk4`, without units, and their last row."""
    command = ["simulate", str(model), "--method", "rk4", *options, "-o", str(out)]
    assert CliRunner().invoke(cli, command, catch_exceptions=False).exit_code == 0
    header, *rows = (out / "trajectory.csv").read_text(encoding="utf-8").splitlines()
    return [column.partition(" [")[0] for column in header.split(",")], [float(x) for x in rows[-1].split(",")]


def test_driven_joints_are_inputs_and_their_forces_outputs(
    crane: tuple[Mechanism, Path], compressor: tuple[Mechanism, Path]
) -> None:
    for (_, unit), joint in ((crane, "swing"), (compressor, "crank")):
        assert validate_fmu(str(unit)) == []
        variables = {v.name: v.causality for v in fmpy.read_model_description(unit).modelVariables}
        assert [variables[f"{kind}_{joint}"] for kind in ("q", "qd", "qdd")] == ["input"] * 3
        assert variables[f"tau_{joint}"] == "output"
        assert f"der(q_{joint})" not in variables


@pytest.mark.parametrize(
    ("name", "joint", "start", "course", "options"),
    [
        ("crane", "swing", (0.1, 0.5, 2.0), "0.1 + 0.5*t + t**2", ("--input", "drive=3")),
        ("compressor", "crank", (0.7, 150.0, 30.0), "0.7 + 150*t + 15*t**2", ("--loops", "projection")),
    ],
)
def test_driven_joints_go_on_with_their_accelerations(
    name: str,
    joint: str,
    start: tuple[float, float, float],
    course: str,
    options: Sequence[str],
    request: pytest.FixtureRequest,
    tmp_path: Path,
) -> None:
    """In co-simulation; with constant acceleration this is the whole motion, in one communication step or in many."""
    unit = request.getfixturevalue(name)[1]
    model = FOLDER / "compressor.yaml" if name == "compressor" else unit.parent / "crane.yaml"
    header, last = _simulate(model, tmp_path, "--duration", "0.05", "--driven", f"{joint}={course}", *options)
    described = fmpy.read_model_description(unit).modelVariables
    given = {f"{kind}_{joint}": value for kind, value in zip(("q", "qd", "qdd"), start, strict=True)}
    given |= {v.name: 3.0 for v in described if v.name == "u_drive"}
    outputs = [v.name for v in described if v.name.startswith(("q_", "qd_", "tau_"))]
    columns = [f"{kind}[{joint}]" for kind, joint in (x.split("_", 1) for x in outputs)]
    for interval in (0.05, 0.01):
        ends = {"stop_time": 0.05, "output_interval": interval}
        found = fmpy.simulate_fmu(str(unit), fmi_type="CoSimulation", start_values=given, output=outputs, **ends)[-1]
        expected = [last[header.index(column)] for column in columns]
        assert list(found)[1:] == pytest.approx(expected, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("size", [0.0, 1e-3])
def test_new_inputs_of_driven_joints_close_the_loops_at_once(
    compressor: tuple[Mechanism, Path], size: float, tmp_path: Path
) -> None:
    """The crank determines all: from new inputs on, the unit is where one stands that began with them."""
    kernels, unit = compressor
    inputs = [f"{kind}_crank" for kind in ("q", "qd", "qdd")]
    joints = [coordinate.name for coordinate in kernels.manifest.coordinates]
    wanted = [f"{kind}_{joint}" for kind in ("q", "qd") for joint in joints] + ["tau_crank"]
    found = []
    for k, starts in enumerate(([(0.7, 150.0, 30.0), (0.75, 140.0, -20.0)], [(0.75, 140.0, -20.0)])):
        with _open(unit, tmp_path / str(k)) as (slave, places):
            slave.setupExperiment()
            slave.enterInitializationMode()
            slave.setReal([places[x] for x in inputs], list(starts[0]))
            slave.exitInitializationMode()
            slave.setReal([places[x] for x in inputs], list(starts[-1]))
            slave.doStep(0.0, size)
            found.append(np.array(slave.getReal([places[x] for x in wanted])))
    q, qd = found[0][: len(joints)], found[0][len(joints) : -1]
    loops = load(FOLDER / "compressor.yaml", extent=LOOPS)
    assert loops("loops", q=q)["gap"] == pytest.approx([0, 0], abs=1e-14)
    assert loops("loop_rates", q=q, qd=qd)["hd"] == pytest.approx([0, 0], abs=1e-11)
    assert found[0] == pytest.approx(found[1], rel=1e-11)


def test_model_exchange_follows_any_course(crane: tuple[Mechanism, Path], tmp_path: Path) -> None:
    """Stages of the Runge-Kutta method, with the inputs of each, are steps of the simulator."""
    unit, h = crane[1], 1e-3
    options = ("--duration", "0.05", "--driven", "swing=sin(3*t)")
    header, last = _simulate(unit.parent / "crane.yaml", tmp_path / "out", *options)
    with _open(unit, tmp_path / "open") as (slave, places):
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        names = ["q_trolley", "qd_trolley"] if "q_trolley" in places else ["q_drive", "qd_drive"]
        state, inputs = [places[x] for x in names], [places[f"{kind}_swing"] for kind in ("q", "qd", "qdd")]

        def slope(t: float, y: np.ndarray) -> np.ndarray:
            slave.setFloat64(state, list(y))
            slave.setFloat64(inputs, [np.sin(3 * t), 3 * np.cos(3 * t), -9 * np.sin(3 * t)])
            return np.array(slave.getFloat64([places[f"der({x})"] for x in names]))

        y = np.zeros(2)
        for k in range(50):
            t = k * h
            a = slope(t, y)
            b = slope(t + h / 2, y + h / 2 * a)
            c = slope(t + h / 2, y + h / 2 * b)
            y = y + h / 6 * (a + 2 * b + 2 * c + slope(t + h, y + h * c))
    expected = [last[header.index(f"{kind}[{joint}]")] for kind, joint in (x.split("_", 1) for x in names)]
    assert y == pytest.approx(expected, rel=1e-12, abs=1e-12)


def test_derivatives_by_the_motion_of_driven_joints_are_the_kernels(
    crane: tuple[Mechanism, Path], tmp_path: Path
) -> None:
    kernels, unit = crane
    rng = np.random.default_rng(5)
    q, qd, u, a = rng.normal(size=2), rng.normal(size=2), rng.normal(size=1), rng.normal(size=1)
    with _open(unit, tmp_path) as (slave, places):
        slave.enterInitializationMode()
        values = dict(zip(("q_drive", "q_swing", "qd_drive", "qd_swing"), (*q, *qd), strict=True))
        values |= {"u_drive": u[0], "qdd_swing": a[0]}
        slave.setFloat64([places[x] for x in values], list(values.values()))
        unknowns = [places[x] for x in ("der(q_drive)", "der(qd_drive)", "tau_swing")]
        arguments: dict[str, Any] = {"q": q, "qd": qd, "u": u, "a": a}
        found = kernels("exp2", **arguments)
        assert slave.getFloat64(unknowns) == pytest.approx([qd[0], found["qdd"][0], found["tau"][0]], abs=1e-14)
        blocks, by = kernels("jac_exp2", **arguments), ("q", "qd", "u", "a")
        rows = [np.hstack([np.atleast_2d(blocks[f"jac_{of}_{x}"])[0] for x in by]) for of in ("qdd", "tau")]
        slopes = np.vstack(([0, 0, 1, 0, 0, 0], rows))
        seed, adjoint = rng.normal(size=6), rng.normal(size=3)
        knowns = [places[x] for x in values]
        forward = slave.getDirectionalDerivative(unknowns, knowns, list(seed))
        backward = slave.getAdjointDerivative(unknowns, knowns, list(adjoint), 6)
    assert forward == pytest.approx(slopes @ seed, abs=1e-12)
    assert backward == pytest.approx(adjoint @ slopes, abs=1e-12)


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
