"""The functions for acados: names and arguments, right values; exact derivatives, by differences in 50 digits."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

from mbsgen.model.changes.scene import Scene
from mbsgen.pipeline import OptionError, Options, generate, make, read_tree, write_families
from mbsgen.request import Request
from mbsgen.tape.interpreter import DIGITS, evaluate
from mbsgen.tape.types import Tape
from tests.reference_models import BRANCHED

MODEL = (
    BRANCHED.replace("length: 0.4", "length: {value: 0.4, kind: differentiated}")
    + """\
wrenches:
  - {name: push, body: left, force: input}
"""
)
N, M, P = 3, 2, 5  # joints, actuated joints; the mass, the length and the three entries of the force
SIZES = {"x": 2 * N, "xdot": 2 * N, "u": M, "z": 0, "multiplier": 2 * N, "t": 1, "p": P, "lambdaX": 2 * N}
STEP = DIGITS.literal(10) ** -15  # the error of a central difference is of the order of its square
CLOSE = 1e-25
Values = dict[str, np.ndarray]

# Of acados' generator: arguments, and results with their sizes.
IMPLICIT = ("x", "xdot", "u", "z", "t", "p")
J = {"x": (2 * N, 2 * N), "xdot": (2 * N, 2 * N), "u": (2 * N, M), "z": (2 * N, 0)}
ALL = 4 * N + M
CONTRACT: dict[str, tuple[tuple[str, ...], dict[str, tuple[int, int]]]] = {
    "impl_dae_fun": (IMPLICIT, {"f_impl": (2 * N, 1)}),
    "impl_dae_fun_jac_x_xdot_z": (IMPLICIT, {"f_impl": (2 * N, 1)} | {f"jac_{k}": J[k] for k in ("x", "xdot", "z")}),
    "impl_dae_fun_jac_x_xdot_u_z": (
        IMPLICIT,
        {"f_impl": (2 * N, 1)} | {f"jac_{k}": J[k] for k in ("x", "xdot", "u", "z")},
    ),
    "impl_dae_fun_jac_x_xdot_u": (IMPLICIT, {"f_impl": (2 * N, 1)} | {f"jac_{k}": J[k] for k in ("x", "xdot", "u")}),
    "impl_dae_jac_x_xdot_u_z": (IMPLICIT, {f"jac_{k}": J[k] for k in ("x", "xdot", "u", "z")}),
    "impl_dae_hess": (("x", "xdot", "u", "z", "multiplier", "t", "p"), {"HESS": (ALL, ALL)}),
    "expl_ode_fun": (("x", "u", "p"), {"f_expl": (2 * N, 1)}),
    "expl_vde_forw": (
        ("x", "Sx", "Sp", "u", "p"),
        {"f_expl": (2 * N, 1), "vdeX": (2 * N, 2 * N), "vdeP": (2 * N, M)},
    ),
    "expl_vde_adj": (("x", "lambdaX", "u", "p"), {"adj": (2 * N + M, 1)}),
}


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("acados") / "branched.yaml"
    path.write_text(MODEL, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def tapes(model: Path) -> dict[str, Tape]:
    families = write_families(read_tree(model), Request(targets=("acados",), functions=("impl", "exp1")))
    return {tape.name: tape for family in families for tape in family.tapes}


@pytest.fixture
def state() -> Values:
    rng = np.random.default_rng(5)
    shapes = {**{name: (size, 1) for name, size in SIZES.items()}, "Sx": (2 * N, 2 * N), "Sp": (2 * N, M)}
    return {
        name: np.vectorize(DIGITS.literal, otypes=[object])(rng.uniform(0.2, 1.5, shape))
        for name, shape in shapes.items()
    }


def compute(tape: Tape, given: Mapping[str, np.ndarray]) -> Values:
    """Evaluate in 50 digits, dense matrices in and out."""
    inputs = {i.name: list(given[i.name].ravel(order="F")) for i in tape.inputs}
    results = {}
    for name, values in evaluate(tape, inputs, DIGITS).items():
        pattern = tape.output(name).sparsity
        assert pattern.is_dense
        results[name] = np.array(values, dtype=object).reshape((pattern.rows, pattern.cols), order="F")
    return results


def slope(f: Callable[[Values], np.ndarray], at: Values, directions: Mapping[str, np.ndarray]) -> np.ndarray:
    """Differentiate along a direction in several inputs at once."""
    ahead, behind = (
        f({**at, **{name: at[name] + sign * STEP * d.reshape(at[name].shape) for name, d in directions.items()}})
        for sign in (1, -1)
    )
    return ((ahead - behind) / (2 * STEP))[:, 0]


def unit(size: int, k: int) -> np.ndarray:
    return np.array([DIGITS.literal(i == k) for i in range(size)], dtype=object)


def assert_equal(found: np.ndarray, expected: np.ndarray) -> None:
    assert found.shape == expected.shape
    assert max((abs(x) for x in (found - expected).ravel()), default=0) < CLOSE


def test_the_functions_have_the_names_and_arguments_that_acados_asks_for(tapes: dict[str, Tape]) -> None:
    for name, (inputs, outputs) in CONTRACT.items():
        tape = tapes[name]
        assert tuple(i.name for i in tape.inputs) == inputs
        assert {o.name: (o.sparsity.rows, o.sparsity.cols) for o in tape.outputs} == outputs
        assert all(i.sparsity.is_dense for i in tape.inputs)


def test_they_say_what_the_kernels_say(tapes: dict[str, Tape], state: Values) -> None:
    """f_impl vanishes at the rates that f_expl gives, and its lower half is the residual."""
    rates = compute(tapes["expl_ode_fun"], state)["f_expl"]
    assert_equal(compute(tapes["impl_dae_fun"], {**state, "xdot": rates})["f_impl"], 0 * rates)
    f = compute(tapes["impl_dae_fun"], state)["f_impl"]
    assert_equal(f[:N], state["xdot"][:N] - state["x"][N:])
    for name in ("impl_dae_fun_jac_x_xdot_z", "impl_dae_fun_jac_x_xdot_u_z", "impl_dae_fun_jac_x_xdot_u"):
        assert_equal(compute(tapes[name], state)["f_impl"], f)
    assert_equal(compute(tapes["expl_vde_forw"], state)["f_expl"], rates)


@pytest.mark.parametrize("name", [name for name in CONTRACT if "_jac_" in name])
def test_jacobians_are_exact(name: str, tapes: dict[str, Tape], state: Values) -> None:
    found = compute(tapes[name], state)
    for result, value in found.items():
        if result.startswith("jac_"):
            by = result.removeprefix("jac_")
            for k in range(SIZES[by]):
                columns = slope(
                    lambda at: compute(tapes["impl_dae_fun"], at)["f_impl"], state, {by: unit(SIZES[by], k)}
                )
                assert_equal(value[:, k], columns)


def test_second_derivatives_are_exact(tapes: dict[str, Tape], state: Values) -> None:
    """Those of multiplier . f_impl by x, xdot, z, u: the slopes of its gradient."""

    def gradient(at: Values) -> np.ndarray:
        blocks = compute(tapes["impl_dae_jac_x_xdot_u_z"], at)
        return np.vstack([blocks[f"jac_{by}"].T @ at["multiplier"] for by in ("x", "xdot", "z", "u")])

    found = compute(tapes["impl_dae_hess"], state)["HESS"]
    columns = [(by, k) for by in ("x", "xdot", "z", "u") for k in range(SIZES[by])]
    for column, (by, k) in enumerate(columns):
        assert_equal(found[:, column], slope(gradient, state, {by: unit(SIZES[by], k)}))


def test_sensitivities_are_exact(tapes: dict[str, Tape], state: Values) -> None:
    """Forward ones are slopes of the rates; the adjoint has the same product with any direction."""
    found = compute(tapes["expl_vde_forw"], state)

    def rates(at: Values) -> np.ndarray:
        return compute(tapes["expl_ode_fun"], at)["f_expl"]

    for k in range(2 * N):
        assert_equal(found["vdeX"][:, k], slope(rates, state, {"x": state["Sx"][:, k]}))
    for k in range(M):
        assert_equal(found["vdeP"][:, k], slope(rates, state, {"x": state["Sp"][:, k], "u": unit(M, k)}))
    adj = compute(tapes["expl_vde_adj"], state)["adj"]
    for by, first in (("x", 0), ("u", 2 * N)):
        for k in range(SIZES[by]):
            weighted = state["lambdaX"][:, 0] @ slope(rates, state, {by: unit(SIZES[by], k)})
            assert abs(adj[first + k, 0] - weighted) < CLOSE


@pytest.mark.parametrize("macros", [(), ("-Dcasadi_int=int",)], ids=["plain", "int"])
def test_the_c_files_speak_with_acados(
    macros: tuple[str, ...],
    model: Path,
    tapes: dict[str, Tape],
    state: Values,
    tmp_path: Path,
    requires: Callable[[str], str],
) -> None:
    """acados asks for int, compiles without a macro that says so, and passes all matrices densely, by position.

    Some hundred roundings lie between inputs and results.
    """
    out = tmp_path / "out"
    generate(model, out, Options(targets=("acados",), functions=("impl", "exp1")))
    sources = [str(out / f"branched_{name}.c") for name in CONTRACT]
    command = [requires("cc"), "-std=c99", "-Wall", "-Wextra", "-Werror", "-O1", *macros, "-fPIC", "-shared"]
    subprocess.run([*command, f"-I{out}", *sources, "-lm", "-o", str(tmp_path / "x.so")], check=True)
    library = ctypes.CDLL(str(tmp_path / "x.so"))
    for name, (inputs, outputs) in CONTRACT.items():
        f = f"branched_{name}"
        assert (library[f"{f}_n_in"](), library[f"{f}_n_out"]()) == (len(inputs), len(outputs))
        pattern = library[f"{f}_sparsity_in"]
        pattern.restype = ctypes.POINTER(ctypes.c_int)
        assert [pattern(i)[0] for i in range(len(inputs))] == [len(state[i]) for i in inputs]
        sizes = [ctypes.c_int(-1) for _ in range(4)]
        assert library[f"{f}_work"](*map(ctypes.byref, sizes)) == 0
        assert [s.value for s in sizes] == [len(inputs), len(outputs), 0, 0]
        given = [np.asfortranarray(state[i].astype(float)) for i in inputs]
        found = [np.full(shape, np.nan, order="F") for shape in outputs.values()]
        arg = (ctypes.c_void_p * len(given))(*(a.ctypes.data for a in given))
        res = (ctypes.c_void_p * len(found))(*(a.ctypes.data for a in found))
        assert library[f](arg, res, None, None, None) == 0
        for value, expected in zip(found, compute(tapes[name], state).values(), strict=True):
            np.testing.assert_allclose(value, expected.astype(float), rtol=1e-13, atol=1e-13)


def test_only_what_can_be_made_of_the_chosen_kernels_is_written(model: Path) -> None:
    def names(**options: object) -> set[str]:
        kernels = make(model, Options(targets=("acados",), **options)).manifest.kernels
        return {k.name for k in kernels} & set(CONTRACT)

    assert names(functions=("exp2",), derivatives=0) == {"expl_ode_fun"}
    assert names(functions=("impl",), derivatives=1) == {n for n in CONTRACT if n.startswith("impl")} - {
        "impl_dae_hess"
    }
    with pytest.raises(OptionError, match="acados: its functions are made of impl, exp1 or exp2; name one"):
        names(functions=("frames",))


def test_an_acados_before_time_gets_functions_without_it(model: Path) -> None:
    """Its integrators count the arguments: x, xdot, u, z, and the parameters last."""
    kernels = {
        k.name: k for k in make(model, Options(targets=("acados-untimed",), functions=("impl",))).manifest.kernels
    }
    for name, (inputs, _) in CONTRACT.items():
        if name in kernels:
            assert tuple(a.name for a in kernels[name].inputs) == tuple(x for x in inputs if x != "t")
    assert "impl_dae_hess" in kernels


@pytest.mark.parametrize("function", ["impl", "exp1"])
def test_mechanisms_with_loops_are_refused(tmp_path: Path, function: str) -> None:
    """An integrator that knows nothing of loops would drift off silently."""
    file = tmp_path / "rod.yaml"
    file.write_text(
        "name: rod\ngravity: [0, -9.81, 0]\nassembly: {x: 1}\nbodies:\n"
        "  - name: bob\n    joint: [{type: prismatic, axis: x, name: x}, {type: prismatic, axis: y, name: y}]\n"
        "    mass: 1\n"
        "loops:\n  - {name: string, type: rod, from: {body: base}, to: {body: bob}, length: 1}\n",
        encoding="utf-8",
    )
    with pytest.raises(OptionError, match="acados: its integrators would let closed loops drift apart"):
        make(file, Options(targets=("acados",), functions=(function,), derivatives=0))


def test_quaternions_are_refused_at_rest_too(tmp_path: Path) -> None:
    """A scene without motion has no velocities by which q could be seen to be the longer vector."""
    model = tmp_path / "bob.yaml"
    model.write_text(
        "name: bob\ngravity: [0, 0, -9.81]\nparameters: {m: {value: 1, kind: runtime}}\nbodies:\n"
        "  - {name: bob, joint: {type: ball}, mass: m, com: [0, 0, -1], inertia: [0.1, 0.1, 0.1]}\n"
    )
    for functions in (("impl",), ("exp2",)):
        scene = Scene(functions=functions, motion=False)
        with pytest.raises(OptionError, match="a joint with a quaternion has more coordinates than velocities"):
            make(model, Options(scene=scene, targets=("acados",), derivatives=1, count=False))
