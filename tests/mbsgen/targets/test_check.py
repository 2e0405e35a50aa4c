"""The check program: content with whole models, in both precisions and under sanitizers; planted faults are found."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import replace
from decimal import Decimal
from pathlib import Path

import pytest

from mbsgen.families import write_families
from mbsgen.formulations import ports
from mbsgen.model.changes.scene import Scene
from mbsgen.pipeline import generate, read_tree
from mbsgen.request import Options, merge
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.replay import declare_inputs, replay
from mbsgen.tape.types import Tape
from mbsgen.targets.c.agreement import compare
from mbsgen.targets.contract import Family
from mbsgen.verification.states import draw
from tests.mbsgen.targets.compilation import Requires, run
from tests.mbsgen.targets.guarded import guarded_tape
from tests.sample import family, sample_families, sample_tape, write_sample

MODELS = Path(__file__).parents[3] / "models"
STEEP = """
name: steep
gravity: [0, 0, -9.81]
bodies:
  - {name: arm, joint: {type: revolute, axis: y, force: LAW}, mass: 1, com: [0.3, 0, 0]}
"""
DRAWN = draw("qd", 1, 0)[0]  # the velocity of the first state
SANITIZED = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")


def build(folder: Path, target: Path, compiler: str, *flags: str) -> Path:
    """Compile all C files of a folder to the check program, as its first lines say."""
    run(compiler, "-std=c99", *flags, *sorted(folder.glob("*.c")), "-lm", "-o", target)
    return target


def check(program: Path) -> tuple[int, dict[str, str]]:
    """Run a check program; return its exit status, and its verdicts by comparison."""
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert done.stderr == ""
    *lines, last = done.stdout.splitlines()
    verdicts = [re.fullmatch(r"(ok|FAULT) +(.*?): .*", line) for line in lines]
    found = {v[2]: v[1] for v in verdicts if v}
    assert len(found) == len(lines)
    assert last == f"{list(found.values()).count('FAULT')} of {len(found)} comparisons found a fault"
    return done.returncode, found


@pytest.mark.parametrize("flags", [("-O0", "-DMBS_REAL=float"), ("-O0", *SANITIZED)], ids=" ".join)
@pytest.mark.parametrize("model", ["arm", "tree"])
def test_whole_models_pass(
    model: str, flags: tuple[str, ...], request: pytest.FixtureRequest, tmp_path: Path, requires: Requires
) -> None:
    """All kernels, on random states: no fault, no read or write out of place, nothing undefined, no leak."""
    folder = request.getfixturevalue(model)
    status, found = check(build(folder, tmp_path / "check", requires("gcc"), *flags))
    assert (status, set(found.values())) == (0, {"ok"})
    for name in ("impl", "sensors"):
        assert f"jac_{name} against differences of {name}" in found
        assert f"adj1_{name} against jac_{name}" in found
        assert f"jac_adj1_{name} against differences of adj1_{name}" in found
    assert "sensors against the last of frames" in found


def write_steep(folder: Path, law: str) -> Path:
    model = folder / "steep.yaml"
    model.write_text(STEEP.replace("LAW", law), encoding="utf-8")
    return model


@pytest.fixture(
    scope="module",
    params=[
        "-0.3*tanh(qd/0.3)",
        "-0.3*tanh(qd/0.15)",
        "-0.3*tanh(10*qd)",
        "-0.3*tanh(20*qd)",
        "-0.3*tanh(1e6*qd)",
        "-0.3*qd/sqrt(qd**2 + 1e-4)",
        "-0.3*qd/sqrt(qd**2 + 1e-12)",
        f"-0.3*tanh(1e6*(qd - {DRAWN - Decimal('5e-5')}))",  # saturated at the state, and not by half a step
        f"-0.3*tanh(1e4*(qd - {DRAWN - Decimal('4e-3')}))",  # the same in single precision
    ],
)
def steep(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Generate a body with steep friction."""
    place = tmp_path_factory.mktemp("steep")
    generate(write_steep(place, request.param), place / "steep", Options(functions=("impl", "exp1")))
    return place / "steep"


@pytest.mark.parametrize("flags", [("-O0",), ("-O0", "-DMBS_REAL=float")], ids=["double", "single"])
def test_steep_laws_pass(steep: Path, flags: tuple[str, ...], tmp_path: Path, requires: Requires) -> None:
    """Friction that turns within a low speed bends derivatives far between two differences, and cancels in them."""
    status, found = check(build(steep, tmp_path / "check", requires("gcc"), *flags))
    assert (status, set(found.values())) == (0, {"ok"})
    assert "jac_adj1_impl against differences of adj1_impl" in found


@pytest.mark.parametrize("runtime", [False, True], ids=["numbers", "parameters"])
@pytest.mark.parametrize("model", ["pendulum", "satellite"])
def test_bounds_and_double_double_pass(model: str, runtime: bool, tmp_path: Path, requires: Requires) -> None:
    """With parameters at run time, which the functions read themselves, whatever their results are called."""
    options = Options(functions=("impl", "frames"), targets=("bounds", "double-double"), runtime=runtime)
    generate(MODELS / f"{model}.yaml", tmp_path / "folder", options)
    status, found = check(build(tmp_path / "folder", tmp_path / "check", requires("gcc"), "-O0"))
    assert (status, set(found.values())) == (0, {"ok"})
    assert {"bounded_impl against 50 digits", "bounded_frames against 50 digits"} <= found.keys()
    assert (tmp_path / "folder" / f"{model}_dd_frames.c").exists()


def test_closed_mechanisms_pass_in_single_precision(closed: Path, tmp_path: Path, requires: Requires) -> None:
    """Derivatives are compared with 50 digits, since loops may be nearly singular at random states."""
    status, found = check(build(closed, tmp_path / "check", requires("gcc"), "-O0", "-DMBS_REAL=float"))
    assert (status, set(found.values())) == (0, {"ok"})
    for name in ("impl", "exp1", "loops", "impl_red"):
        assert f"adj1_{name} against jac_{name}" in found
        for kernel in (name, f"jac_{name}", f"jac_adj1_{name}"):
            assert f"{kernel} against 50 digits" in found


def test_accelerations_pass_where_loops_nearly_depend_on_each_other(tmp_path: Path, requires: Requires) -> None:
    """At a random pose of this model, rounding of the pose changes accelerations by more than usual."""
    generate(MODELS / "compressor.yaml", tmp_path / "folder", Options(functions=("exp1", "exp2"), derivatives=0))
    status, found = check(build(tmp_path / "folder", tmp_path / "check", requires("gcc"), "-DMBS_REAL=float"))
    assert (status, found["exp1 against exp2"]) == (0, "ok")


# -- planted faults -------------------------------------------------------------------------------------------------


def changed(tape: Tape | None, output: str, change: Callable[[Builder, list[Scalar]], list[Scalar]]) -> Tape:
    """Change the values of an output."""
    assert tape is not None
    builder = Builder()
    values = replay(tape, builder, declare_inputs(tape, builder))
    for o in tape.outputs:
        results = [values[v] for v in o.values]
        builder.output(o.port, o.sparsity, change(builder, results) if o.name == output else results)
    return builder.build(tape.function)


MODELS = Path(__file__).parents[3] / "models"
INPUTS = {port.name: port for port in (ports.COORDINATES, ports.VELOCITIES, ports.ACCELERATIONS, ports.FORCES)}


def turn_last(_: Builder, values: list[Scalar]) -> list[Scalar]:
    return [*values[:-1], -values[-1]]


def scale_first(builder: Builder, values: list[Scalar]) -> list[Scalar]:
    return [builder.number(1.0 + 1e-5) * values[0], *values[1:]]


def lose_first(builder: Builder, values: list[Scalar]) -> list[Scalar]:
    """Take the root of a negative number."""
    return [builder.sqrt(-builder.number(1.0) - values[0] * values[0]), *values[1:]]


def without(tape: Tape | None, output: str) -> Tape:
    """Leave an output out: its block counts as structurally zero."""
    assert tape is not None
    return replace(tape, outputs=tuple(o for o in tape.outputs if o.name != output))


SOUND = family(sample_tape())
JACOBIAN = "jac_impl against differences of impl"
ADJOINT = "adj1_impl against jac_impl"
SECOND = "jac_adj1_impl against differences of adj1_impl"
PLANTED: Mapping[str, tuple[Family, set[str]]] = {
    "nothing": (SOUND, set()),
    "sign": (replace(SOUND, jac=changed(SOUND.jac, "jac_f_x", turn_last)), {JACOBIAN, ADJOINT}),
    "digits": (replace(SOUND, jac=changed(SOUND.jac, "jac_g_x", scale_first)), {JACOBIAN, ADJOINT}),
    "missing block": (replace(SOUND, jac=without(SOUND.jac, "jac_f_y")), {JACOBIAN, ADJOINT}),
    "not a number": (replace(SOUND, jac=changed(SOUND.jac, "jac_f_x", lose_first)), {JACOBIAN, ADJOINT}),
    "adjoint": (replace(SOUND, adj1=changed(SOUND.adj1, "adj_y", scale_first)), {ADJOINT, SECOND}),
    "second": (replace(SOUND, jac_adj1=changed(SOUND.jac_adj1, "jac_adj_x_y", turn_last)), {SECOND}),
    "second, missing": (replace(SOUND, jac_adj1=without(SOUND.jac_adj1, "jac_adj_x_adj_f")), {SECOND}),
    "failing kernel": (family(guarded_tape()), {JACOBIAN, ADJOINT, SECOND}),  # inputs of random sign
}


@pytest.mark.parametrize("fault", PLANTED)
def test_planted_faults_are_found_and_nothing_else(fault: str, tmp_path: Path, requires: Requires) -> None:
    planted, expected = PLANTED[fault]
    folder = write_sample(tmp_path / "sample", families=(sample_families()[0], planted))
    status, found = check(build(folder, tmp_path / "check", requires("gcc"), "-O0"))
    assert {name for name, verdict in found.items() if verdict == "FAULT"} == expected
    assert status == bool(expected)


STEEP_FAULTS: Mapping[str, Callable[[Family], Family]] = {
    JACOBIAN: lambda sound: replace(sound, jac=changed(sound.jac, "jac_Phi_q", scale_first)),
    ADJOINT: lambda sound: replace(sound, adj1=changed(sound.adj1, "adj_qd", scale_first)),
    SECOND: lambda sound: replace(sound, jac_adj1=changed(sound.jac_adj1, "jac_adj_q_q", scale_first)),
}


@pytest.fixture(scope="module")
def steep_families(tmp_path_factory: pytest.TempPathFactory) -> tuple[Family, ...]:
    """Write the functions of a body with steep friction."""
    model = write_steep(tmp_path_factory.mktemp("steep"), "-0.1*qd - 0.3*tanh(20*qd)")
    return write_families(read_tree(model), merge(Options(functions=("impl",)), Scene(functions=None)))


@pytest.mark.parametrize("fault", STEEP_FAULTS)
def test_planted_faults_are_found_beside_steep_laws(
    fault: str, steep_families: tuple[Family, ...], tmp_path: Path, requires: Requires
) -> None:
    """A fault of 1e-5 in a number, though many steps are tried where a law is steep."""
    planted = tuple(STEEP_FAULTS[fault](f) if f.value.name == "impl" else f for f in steep_families)
    status, found = check(build(write_sample(tmp_path / "s", families=planted), tmp_path / "check", requires("gcc")))
    assert status == 1
    assert found[fault] == "FAULT"


def write_oscillator(folder: Path, **faults: float) -> Path:
    """Write 2 qdd + qd + 3 q - u = 0 as all functions; a fault is what is added to a result."""
    inputs = {
        "impl": ("q", "qd", "qdd", "u"),
        "semi": ("q", "qd"),
        "semi_res": ("q", "qd", "qdd", "u"),
        "exp1": ("q", "qd", "u"),
        "exp2": ("q", "qd", "u"),
        "sensors": ("q",),
        "frames": ("q",),
    }
    families = []
    for name, names in inputs.items():
        b = Builder()
        x = {i: b.vector(INPUTS[i], 1)[0] for i in names}
        number = b.number

        def off(output: str, value: Scalar, kernel: str = name, builder: Builder = b) -> Scalar:
            fault = faults.get(f"{kernel}_{output}")
            return value + builder.number(fault) if fault else value

        c = x["qd"] + number(3.0) * x["q"] if "qd" in x else b.zero
        if "qdd" in x:
            b.output_dense(ports.RESIDUAL, [[off("Phi", number(2.0) * x["qdd"] + c - x["u"])]])
        elif name == "semi":
            b.output_dense(ports.MASS_MATRIX, [[off("M", number(2.0))]])
            b.output_dense(ports.BIAS, [[off("c", c)]])
        elif "u" in x:
            b.output_dense(ports.ACCELERATIONS, [[off("qdd", (x["u"] - c) / number(2.0))]])
        else:
            columns, places = (1, ports.POSITION) if name == "sensors" else (2, ports.ORIGINS)
            b.output_dense(places, [[off("p", x["q"]) for _ in range(columns)]] * 3)
        families.append(Family(b.build(name)))
    return write_sample(folder, families=tuple(families))


RELATIONS: Mapping[str, set[str]] = {
    "semi_res_Phi": {"semi_res against impl"},
    "semi_M": {"semi (M) against impl"},
    "semi_c": {"semi (c) against impl"},
    "exp1_qdd": {"exp1 put into impl", "exp1 against exp2"},
    "exp2_qdd": {"exp2 put into impl", "exp1 against exp2"},
    "frames_p": {"sensors against the last of frames"},
}


@pytest.mark.parametrize("fault", RELATIONS)
def test_functions_that_disagree_are_found(fault: str, tmp_path: Path, requires: Requires) -> None:
    folder = write_oscillator(tmp_path / "oscillator", **{fault: 1e-4})
    status, found = check(build(folder, tmp_path / "check", requires("gcc"), "-O0"))
    assert set().union(*RELATIONS.values()) == set(found)
    assert {name for name, verdict in found.items() if verdict == "FAULT"} == RELATIONS[fault]
    assert status == 1


def test_a_function_of_several_is_compared_by_its_reference_alone() -> None:
    """The check program takes the first result for the accelerations, so `step` must not be put into `impl`."""
    scene = Scene(together=(("step", ("sensors", "exp1")),), functions=("impl", "frames", "sensors"), derivatives=0)
    families = write_families(read_tree(MODELS / "double_pendulum.yaml"), merge(Options(), scene))
    assert [c.kernels for c in compare(families, only_driven=True)] == [("sensors", "frames")]
