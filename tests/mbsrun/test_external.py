"""The CasADi face: exact values and derivatives with their patterns, and proof that IPOPT uses the generated ones."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import mbsgen.pipeline
from mbsgen.errors import InputError, MbsError
from mbsgen.tape.builder import Builder
from mbsgen.tape.replay import declare_inputs, replay
from mbsgen.tape.types import Tape
from mbsgen.targets.contract import Family
from mbsrun import Mechanism, load
from mbsrun.external import load_on_demand
from mbsrun.kernel import ArgumentError
from mbsrun.models import INTEGRATED
from tests.mbsgen.targets.guarded import guarded_tape
from tests.mbsrun.sample_inputs import EPS, ROUNDING, draw, hidden
from tests.sample import PARAMETERS, family, sample_families, sample_tape, write_sample

SIZES = {"x": 3, "y": 2, "u": 0, "z": 1}
STATE = {"x": [0.4, 0.9, 1.3], "y": [0.7, 1.1], "u": [], "z": [0.2]}


@pytest.fixture(scope="module")
def k(tmp_path_factory: pytest.TempPathFactory) -> Mechanism:
    """The sample with run-time parameters."""
    return load(write_sample(tmp_path_factory.mktemp("sample")))


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Mechanism:
    """The sample with constants only."""
    families = sample_families(parametric=False)
    return load(write_sample(tmp_path_factory.mktemp("plain"), "plain", families))


def as_sx(tape: Tape, given: dict[str, ca.SX]) -> dict[str, ca.SX]:
    """Run the tape over CasADi's own symbols: its differentiation of the same equations is the reference."""
    values = [value for i in tape.inputs for value in ca.vertsplit(given[i.name])] if given else []
    values += [ca.SX(float(x)) for x in tape.literals]
    calls = {"sin": ca.sin, "cos": ca.cos, "sqrt": ca.sqrt, "neg": lambda a: -a}
    signs = {"+": ca.plus, "-": ca.minus, "*": ca.times, "/": ca.rdivide}
    for op, a, b in tape.operations:
        name = op.value[0]
        values.append(calls[name](values[a]) if op.arity == 1 else signs[name](values[a], values[b]))
    results = {}
    for output in tape.outputs:
        matrix = ca.SX(output.sparsity.rows, output.sparsity.cols)
        for place, value in zip(output.sparsity.entries, output.values, strict=True):
            matrix[place] = values[value]
        results[output.name] = matrix
    return results


def reference(parametric: bool) -> ca.Function:
    """The sample as a CasADi function of x, y, u, z."""
    symbols = {name: ca.SX.sym(name, size) for name, size in SIZES.items()}
    given = {**symbols, "h": ca.SX(hidden(PARAMETERS))} if parametric else symbols
    results = as_sx(sample_tape(parametric=parametric), given)
    return ca.Function("reference", list(symbols.values()), list(results.values()), list(symbols), list(results))


def second_order(f: ca.Function) -> tuple[ca.Function, ca.Function]:
    """Make the Jacobian of all results, and the Hessian of their weighted sum, by x, y, z."""
    x = {name: ca.MX.sym(name, size) for name, size in SIZES.items()}
    results = f(**x)
    column = ca.vertcat(results["f"], ca.densify(results["g"])[:])
    unknown, weights = ca.vertcat(x["x"], x["y"], x["z"]), ca.MX.sym("w", column.numel())
    inputs = list(x.values())
    hessian = ca.hessian(ca.dot(weights, column), unknown)[0]
    return ca.Function("J", inputs, [ca.jacobian(column, unknown)]), ca.Function("H", [*inputs, weights], [hessian])


@pytest.mark.parametrize("parametric", [True, False])
def test_values_and_derivatives_are_those_of_the_tape(parametric: bool, k: Mechanism, plain: Mechanism) -> None:
    """To second order, with CasADi's own differentiation of the same equations as reference, and its patterns."""
    function, own = (k if parametric else plain).casadi("impl"), reference(parametric)
    assert function.name_in() == list(SIZES)
    assert function.name_out() == ["f", "g"]
    for found, expected in zip(function(*STATE.values()), own(*STATE.values()), strict=True):
        assert found.sparsity() == expected.sparsity()
        np.testing.assert_allclose(found.full(), expected.full(), rtol=ROUNDING, atol=ROUNDING)
    weights = [0.3, -1.2, 0.8, 1.1, -0.4, 0.9, 0.5]
    for found, expected, arguments in zip(
        second_order(function), second_order(own), (STATE.values(), (*STATE.values(), weights)), strict=True
    ):
        assert found.sparsity_out(0) == expected(*arguments).sparsity()
        np.testing.assert_allclose(found(*arguments).full(), expected(*arguments).full(), rtol=0, atol=10 * ROUNDING)


@pytest.mark.parametrize("parametric", [True, False])
@pytest.mark.parametrize("name", ["jac_impl", "adj1_impl", "jac_adj1_impl"])
def test_derivatives_are_the_generated_ones_alone(name: str, parametric: bool, k: Mechanism, plain: Mechanism) -> None:
    """With fixed parameters too: each is a call of its kernel, whose results no operation of CasADi's changes."""
    function = (k if parametric else plain).casadi("impl")
    derivative = {
        "jac_impl": function.jacobian,
        "adj1_impl": lambda: function.reverse(1),
        "jac_adj1_impl": lambda: function.reverse(1).jacobian(),
    }[name]()
    if parametric:
        kinds = {derivative.instruction_id(i) for i in range(derivative.n_instructions())}
        assert kinds <= {ca.OP_INPUT, ca.OP_CONST, ca.OP_CALL, ca.OP_OUTPUT}
        (derivative,) = derivative.find_functions()
    assert derivative.class_name() == "External"
    assert derivative.name().startswith(name.removesuffix("impl"))


@pytest.mark.parametrize("name", ["impl", "jac_impl", "adj1_impl", "jac_adj1_impl"])
def test_every_kernel_has_a_casadi_function(name: str, k: Mechanism) -> None:
    """With the inputs and outputs of the manifest, and the values of the NumPy face."""
    own = sample_families()[1]
    tape = {t.name: t for t in (own.value, own.jac, own.adj1, own.jac_adj1) if t is not None}[name]
    inputs = draw(tape, 1)
    function, expected = k.casadi(name), k(name, **inputs)
    assert function.name_in() == [a.name for a in k.manifest.kernel(name).inputs if a.name != "h"]
    assert function.name_out() == [a.name for a in k.manifest.kernel(name).outputs]
    given = {key: ca.DM(function.sparsity_in(key), array.T[array.T != 0]) for key, array in inputs.items()}
    found = function(**given)
    for key, value in expected.items():
        np.testing.assert_array_equal(found[key].full().reshape(value.shape), value)


def test_setup_is_a_casadi_function_too(k: Mechanism) -> None:
    np.testing.assert_allclose(k.casadi("setup")([2, 3]).full()[:, 0], [6, 2], rtol=0, atol=0)


def test_parameters_are_baked_in(k: Mechanism) -> None:
    changed = k.with_parameters(length=0.1)
    inputs = {name: np.array(value, dtype=float) for name, value in STATE.items()}
    for mechanism in (k, changed):
        found = mechanism.casadi("impl")(**STATE)["f"].full()[:, 0]
        np.testing.assert_array_equal(found, mechanism.impl(**inputs)["f"])
    assert k.casadi("impl")(**STATE)["f"][2] != changed.casadi("impl")(**STATE)["f"][2]


def test_casadi_takes_no_derivative_by_the_hidden_input(k: Mechanism) -> None:
    bare = ca.external("sample_impl", str(k.compile("impl", "jac_impl")))
    assert [bare.is_diff_in(i) for i in range(5)] == [True, True, True, True, False]
    h = ca.MX.sym("h", 2)
    assert ca.jacobian(bare(**STATE, h=h)["f"], h).nnz() == 0


@pytest.mark.parametrize("name", ["gamma", "j0", "sample_impl", "", "impl_n_in"])
def test_only_kernels_of_the_manifest_are_given(name: str, k: Mechanism) -> None:
    """`external("gamma", …)` would find libm's gamma, and give 0."""
    with pytest.raises(ArgumentError, match=f"sample has no kernel '{name}'"):
        k.casadi(name)


def test_a_failed_guard_is_told_to_casadi(tmp_path: Path) -> None:
    """The status reaches CasADi, which raises; IPOPT takes it for a point it cannot evaluate, and steps back."""
    own = family(guarded_tape())
    failing = load(write_sample(tmp_path, families=(own,)))
    for name in ("impl", "jac_impl", "adj1_impl", "jac_adj1_impl"):
        function = failing.casadi(name)
        sound = {"x": [1, 2], "y": [1, 1, 1], "adj_f": [1, 1]}
        given = {key: value for key, value in sound.items() if key in function.name_in()}
        function(**given)
        with pytest.raises(RuntimeError, match=failing.manifest.kernel(name).symbol):
            function(**{**given, "y": [1, 0, 1]})


@pytest.mark.parametrize("parallelization", ["serial", "thread"])
@pytest.mark.parametrize("parametric", [True, False])
def test_maps_give_each_state_its_results(
    parametric: bool, parallelization: str, k: Mechanism, plain: Mechanism
) -> None:
    """Values and Jacobian blocks of 8 states at once equal separate calls; so kernels are reentrant."""
    mechanism = k if parametric else plain
    states = {name: array.T for name, array in draw(sample_tape(), 2, states=8).items()}
    mapped = mechanism.casadi("impl").map(8, parallelization, 2)
    x = ca.MX.sym("x", 3, 8)
    values = ca.Function("F", [x], [mapped(**{**states, "x": x})["f"]])
    slopes = ca.Function("J", [x], [ca.jacobian(values(x), x)])
    blocks = slopes(states["x"])
    assert blocks.nnz() == 8 * 7  # of each block, the seven entries that are not structurally zero
    for i in range(8):
        alone = {name: array[:, i] for name, array in states.items()}
        np.testing.assert_array_equal(values(states["x"])[:, i].full()[:, 0], mechanism.impl(**alone)["f"])
        found = blocks[3 * i : 3 * i + 3, 3 * i : 3 * i + 3].full()
        np.testing.assert_array_equal(found, mechanism.jac_impl(**alone)["jac_f_x"])


FUNCTIONS = ("semi_res", "exp1", "exp2", "sensors", "motion", "impl")


@pytest.fixture(scope="module")
def pendulum() -> tuple[Mechanism, dict[str, Tape]]:
    """Two links with a sensor: loaded, and as tapes."""
    path = Path(__file__).parents[2] / "models" / "double_pendulum.yaml"
    families = mbsgen.pipeline.write_families(mbsgen.pipeline.read_tree(path))
    return load(path), {family.value.name: family.value for family in families}


def numbers(function: ca.Function, seed: int, states: int | None = None) -> list[np.ndarray]:
    """Draw the inputs of a function, or of several states side by side."""
    rng = np.random.default_rng(seed)
    return [rng.uniform(0.2, 1.5, (function.size1_in(i), states or 1)) for i in range(function.n_in())]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_every_function_of_a_model_has_exact_derivatives(
    name: str, pendulum: tuple[Mechanism, dict[str, Tape]]
) -> None:
    """To second order, within MX; the reference is CasADi's differentiation of the tape's equations.

    A few hundred roundings lie between inputs and results; the pivots of this mechanism are well conditioned.
    """
    mechanism, tape = pendulum[0], pendulum[1][name]
    external = mechanism.casadi(name)
    symbols = [ca.SX.sym(i.name, i.sparsity.rows) for i in tape.inputs]
    results = as_sx(tape, dict(zip(external.name_in(), symbols, strict=True)))
    own = ca.Function("own", symbols, list(results.values()), external.name_in(), external.name_out())
    for derived in (lambda f: f, jacobian_of, hessian_of):
        found, expected = derived(external), derived(own)
        given = numbers(found, 1)
        for value, reference in zip(found.call(given), expected.call(given), strict=True):
            scale = max(1.0, float(ca.norm_inf(ca.vec(ca.densify(reference)))))
            np.testing.assert_allclose(value.full(), reference.full(), rtol=0, atol=300 * EPS * scale)


def jacobian_of(f: ca.Function) -> ca.Function:
    """Make the Jacobian of all results by all inputs, through MX."""
    x, column = column_of(f)
    return ca.Function("J", [x], [ca.jacobian(column, x)])


def hessian_of(f: ca.Function) -> ca.Function:
    """Make the Hessian of a weighted sum of all results by all inputs, through MX."""
    x, column = column_of(f)
    weights = ca.MX.sym("w", column.numel())
    return ca.Function("H", [x, weights], [ca.hessian(ca.dot(weights, column), x)[0]])


def column_of(f: ca.Function) -> tuple[ca.MX, ca.MX]:
    """Make one column of all inputs, and one of all results."""
    sizes = [f.size1_in(i) for i in range(f.n_in())]
    x = ca.MX.sym("x", sum(sizes))
    results = f.call(ca.vertsplit(x, np.cumsum([0, *sizes]).tolist()))
    return x, ca.vertcat(*(ca.vec(ca.densify(result)) for result in results))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_of_a_model_can_be_mapped_over_threads(
    name: str, pendulum: tuple[Mechanism, dict[str, Tape]]
) -> None:
    function = pendulum[0].casadi(name)
    given = numbers(function, 2, states=6)
    mapped = function.map(6, "thread", 2).call([ca.DM(a) for a in given])
    for i in range(6):
        alone = function.call([a[:, i] for a in given])
        for block, value in zip(mapped, alone, strict=True):
            columns = value.shape[1]
            np.testing.assert_array_equal(block[:, columns * i : columns * (i + 1)].full(), value.full())


def test_accelerations_can_stand_in_a_nonlinear_program(pendulum: tuple[Mechanism, dict[str, Tape]]) -> None:
    """Find the torques of given accelerations: the original ones, to IPOPT's tolerance."""
    mechanism = pendulum[0]
    q, qd = np.array([0.3, -0.4]), np.array([0.5, 0.2])
    size = mechanism.casadi("exp2").size1_in("u")
    u = ca.MX.sym("u", size)
    found = mechanism.casadi("exp2")(q=q, qd=qd, u=u)["qdd"]
    wanted = mechanism.exp2(q=q, qd=qd, u=np.ones(size))["qdd"]
    options = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-11}}
    solver = ca.nlpsol("solver", "ipopt", {"x": u, "f": ca.sumsqr(found - wanted)}, options)
    solution = solver(x0=[0] * size)
    assert solver.stats()["return_status"] == "Solve_Succeeded"
    np.testing.assert_allclose(solution["x"].full()[:, 0], 1, rtol=0, atol=1e-8)


# -- IPOPT ----------------------------------------------------------------------------------------------------------


def scaled(tape: Tape | None, factor: float) -> Tape:
    """Multiply every result of a tape."""
    assert tape is not None
    builder = Builder()
    values = replay(tape, builder, declare_inputs(tape, builder))
    for output in tape.outputs:
        results = [builder.number(factor) * values[v] for v in output.values]
        builder.output(output.port, output.sparsity, results)
    return builder.build(tape.function)


def variant(folder: Path, *, jac: float = 1.0, jac_adj1: float = 1.0) -> Mechanism:
    """Compile the sample with its Jacobian, or its second derivatives, scaled: wrong on purpose."""
    own: Family = family(sample_tape(parametric=False))
    changed = replace(own, jac=scaled(own.jac, jac), jac_adj1=scaled(own.jac_adj1, jac_adj1))
    return load(write_sample(folder, families=(changed,)))


def make_solver(mechanism: Mechanism, **options: object) -> ca.Function:
    """Reach given values of f and of a row of g with small x and y."""
    x, y = ca.MX.sym("x", 3), ca.MX.sym("y", 2)
    results = mechanism.casadi("impl")(x=x, y=y, u=ca.MX(0, 1), z=0.5)
    goal = ca.vertcat(results["f"], results["g"][1, 0])
    nlp = {"x": ca.vertcat(x, y), "f": ca.sumsqr(x) + ca.sumsqr(y), "g": goal}
    return ca.nlpsol("solver", "ipopt", nlp, {"print_time": False, **options})


def evaluate_nlp(solver: ca.Function) -> tuple[np.ndarray, np.ndarray]:
    """Evaluate the constraints' Jacobian, and the Lagrangian's Hessian without the cost's part."""
    at, weights = [*STATE["x"], *STATE["y"]], [1.0, -2.0, 0.5, 0.7]
    jacobian = solver.get_function("nlp_jac_g")(at, [])[-1].full()
    hessian = solver.get_function("nlp_hess_l")(at, [], 0.0, weights).full()
    return jacobian, hessian


def test_ipopt_evaluates_the_generated_derivatives(tmp_path: Path) -> None:
    """Scale them, and what IPOPT is given follows: nothing is differentiated by other means."""
    jacobian, hessian = evaluate_nlp(make_solver(variant(tmp_path / "clean")))
    wrong_jacobian, same_hessian = evaluate_nlp(make_solver(variant(tmp_path / "jac", jac=1.01)))
    same_jacobian, wrong_hessian = evaluate_nlp(make_solver(variant(tmp_path / "hess", jac_adj1=1.5)))
    np.testing.assert_allclose(wrong_jacobian, 1.01 * jacobian, rtol=1e-14)
    np.testing.assert_allclose(same_jacobian, jacobian, rtol=1e-14)
    np.testing.assert_allclose(wrong_hessian, 1.5 * hessian, rtol=1e-14)
    np.testing.assert_allclose(same_hessian, hessian, rtol=1e-14)
    assert np.abs(hessian).max() > 0.1


def check_by_ipopt(mechanism: Mechanism, capfd: pytest.CaptureFixture[str]) -> int:
    """Make IPOPT compare the derivatives with differences, to second order; count its errors."""
    options = {"derivative_test": "second-order", "point_perturbation_radius": 0.0, "max_iter": 0, "sb": "yes"}
    solver = make_solver(mechanism, ipopt=options)
    solver(x0=[*STATE["x"], *STATE["y"]], lbg=0, ubg=0)
    told = capfd.readouterr().out
    if "No errors detected by derivative checker" in told:
        return 0
    found = re.search(r"Derivative checker detected (\d+) error", told)
    assert found, told
    return int(found[1])


def test_ipopt_finds_no_error_in_them_and_many_when_they_are_scaled(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert check_by_ipopt(variant(tmp_path / "clean"), capfd) == 0
    assert check_by_ipopt(variant(tmp_path / "jac", jac=1.01), capfd) > 5
    assert check_by_ipopt(variant(tmp_path / "hess", jac_adj1=1.5), capfd) > 5


def test_ipopt_solves_with_them(k: Mechanism) -> None:
    """From a state to the values it has: a point of the constraints is found, to IPOPT's tolerance."""
    solver = make_solver(k, ipopt={"print_level": 0, "sb": "yes", "tol": 1e-10})
    inputs = {name: np.array(value, dtype=float) for name, value in STATE.items()}
    results = k.impl(**{**inputs, "z": np.array([0.5])})
    goal = [*results["f"], results["g"][1, 0]]
    solution = solver(x0=[0.5, 0.8, 1.2, 0.6, 1.0], lbg=goal, ubg=goal)
    assert solver.stats()["return_status"] == "Solve_Succeeded"
    assert solver.stats()["iter_count"] < 20
    np.testing.assert_allclose(solution["g"].full()[:, 0], goal, rtol=0, atol=1e-9)


# -- model files ----------------------------------------------------------------------------------------------------

MODEL = """\
name: swing
gravity: [0, 0, -9.81]
bodies:
  - name: arm
    joint: {type: revolute, axis: y}
    mass: 2
    com: [0, 0, -0.5]
    inertia: {xx: 0.1, yy: 0.1, zz: 0.1}
"""


@pytest.fixture
def model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A model file, and an empty cache."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    path = tmp_path / "swing.yaml"
    path.write_text(MODEL)
    return path


def kept(model: Path) -> list[Path]:
    return sorted(path for path in (model.parent / "cache" / "mbsgen" / "models").iterdir() if path.is_dir())


def test_a_model_file_is_generated_once(model: Path) -> None:
    """With gravity along -z: Phi = (0.1 + 2 0.5^2) qdd + 2 9.81 0.5 sin(q)."""
    first = load(model)
    assert first.impl(q=[0.3], qd=[0], qdd=[2], u=[0])["Phi"][0] == pytest.approx(1.2 + 9.81 * np.sin(0.3), rel=1e-14)
    (folder,) = kept(model)
    before = folder.stat().st_ino
    elsewhere = model.with_name("copy of it")
    elsewhere.write_text(MODEL)
    assert load(elsewhere).compile("impl") == first.compile("impl")
    assert [folder.stat().st_ino] == [before] == [f.stat().st_ino for f in kept(model)]


def test_another_text_or_another_generator_makes_another_folder(model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    library = load(model).compile("impl")
    model.write_text(MODEL.replace("mass: 2", "mass: 3"))
    assert load(model).compile("impl") != library
    monkeypatch.setattr("mbsrun.models.fingerprint_generator", lambda: b"of another version")
    load(model)
    assert len(kept(model)) == 3


def test_a_model_that_changes_while_it_is_generated_is_generated_again(
    model: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file kept under the name of a text was made from that text."""
    generate, texts = mbsgen.pipeline.generate, [MODEL.replace("mass: 2", "mass: 3")]

    def disturbed(path: Path, out: Path, options: mbsgen.pipeline.Options) -> None:
        if texts:
            path.write_text(texts.pop())
        generate(path, out, options)

    monkeypatch.setattr("mbsgen.pipeline.generate", disturbed)
    changed = load(model)
    assert len(kept(model)) == 1
    model.write_text(MODEL)
    assert load(model).compile("impl") != changed.compile("impl")
    assert len(kept(model)) == 2


def test_a_refused_model_leaves_nothing_in_the_cache(model: Path) -> None:
    model.write_text(MODEL.replace("mass: 2", "mass: -2"))
    with pytest.raises(InputError, match=r"swing\.yaml:6: bodies\[0\]\.mass"):
        load(model)
    assert kept(model) == []


@pytest.mark.parametrize(
    ("name", "message"), [("none.yaml", r"none\.yaml: there is no such file"), ("none", r"manifest\.json: there is no")]
)
def test_a_path_to_nothing_is_told(name: str, message: str, model: Path) -> None:
    with pytest.raises(InputError, match=message):
        load(model.with_name(name))


def test_many_processes_may_load_a_model_at_once(model: Path) -> None:
    script = "import sys, mbsrun; print(mbsrun.load(sys.argv[1]).compile('impl', 'frames'))"
    command = [sys.executable, "-c", script, str(model)]
    running = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(3)]
    assert len({process.communicate()[0] for process in running}) == 1
    assert [process.returncode for process in running] == [0, 0, 0]
    assert len(kept(model)) == 1


def test_functions_are_generated_when_they_are_asked_for(model: Path) -> None:
    """A residual, its Jacobian and poses at first; then what is asked for and no more, with its second derivatives."""
    swing = load_on_demand(model)
    assert {kernel.name for kernel in swing.manifest.kernels} >= {"impl", "jac_impl", "frames"}
    assert not {kernel.name for kernel in swing.manifest.kernels} & {"exp1", "jac_adj1_impl", "sensors"}
    state = {"q": [0.3], "qd": [0.0], "u": [1.0]}
    assert len(kept(model)) == 1
    assert swing("exp2", **state)["qdd"] == pytest.approx(load(model)("exp2", **state)["qdd"], rel=1e-14)
    assert len(kept(model)) == 3  # one of exp2, and the whole that it was compared with
    hessian = swing.casadi("exp2").reverse(1).jacobian()
    assert hessian.name() == f"jac_adj1_{swing.manifest.prefix}_exp2"
    assert len(kept(model)) == 3
    with pytest.raises(MbsError, match="nonsense"):
        swing("jac_nonsense", **state)


def test_simulations_generate_derivatives_of_accelerations_where_these_are_called(model: Path) -> None:
    """With gravity along -z: qdd = (u - 9.81 sin(q)) / 0.6, which moves by -9.81 cos(q) / 0.6 with q."""
    swing = load(model, extent=INTEGRATED)
    state = {"q": [0.3], "qd": [0.0], "u": [1.0]}
    assert swing.exp2(**state)["qdd"][0] == pytest.approx((1.0 - 9.81 * np.sin(0.3)) / 0.6, rel=1e-14)
    assert {"exp1", "exp2", "jac_impl", "jac_semi_res"} <= {kernel.name for kernel in swing.manifest.kernels}
    assert not {"jac_exp1", "lin_exp2"} & {kernel.name for kernel in swing.manifest.kernels}
    assert len(kept(model)) == 1
    for slope in (swing.jac("exp2", **state)["jac_qdd_q"], swing.jac("exp", **state)["jac_qdd_q"]):
        assert slope.item() == pytest.approx(-9.81 * np.cos(0.3) / 0.6, rel=1e-14)
    assert len(kept(model)) <= 3  # exp may be exp1
    assert swing.casadi("exp2").jacobian().name() == f"jac_{swing.manifest.prefix}_exp2"
    with pytest.raises(MbsError, match="jac_adj1_exp2"):  # second derivatives were not asked for
        swing.hess("exp2", **state)
