"""Joints that follow others: the equations are GT M G, GT c, GT Phi of the uncoupled tree, as Pinocchio computes them.

G is written here once more, by hand, from the couplings. The error of a comparison is some rounding of the largest
entry, times the digits lost in solving with the mass matrix: 1e-10 where it is solved for, 1e-12 elsewhere. Derivatives
are compared with central differences in 50 digits, whose error is the step squared, 1e-30. But random rotations are
orthonormal only to rounding, and recursions that use this differ by as much: 1e-13.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen.approximation.choice import approximate
from mbsgen.approximation.states import draw as draw_states
from mbsgen.errors import InputError
from mbsgen.expressions import Number
from mbsgen.formulations.catalogue import FUNCTIONS
from mbsgen.formulations.reductions import Reductions
from mbsgen.model.changes.locking import lock
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.changes.releasing import with_runtime_numbers
from mbsgen.model.changes.scene import EVERYTHING
from mbsgen.model.construction import Setting, body, frame, free, make_model, revolute, runtime
from mbsgen.model.model import Model
from mbsgen.model.reader import read_model
from mbsgen.model.symbols import exact
from mbsgen.model.tree import Coupling, Kind, Tree
from mbsgen.model.writer import write_model
from mbsgen.pipeline import Options, make, write_families
from mbsgen.request import Request, merge
from mbsgen.tape.interpreter import DIGITS, evaluate
from mbsgen.tape.types import Tape
from tests.mbsgen.failures.mechanisms import spatial_chain
from tests.mbsgen.targets.compilation import Requires, run
from tests.random_scenes import random_model
from tests.random_trees import Pinocchio, law_forces, random_tree, values_of, with_laws, with_rotors, with_wrenches

Array = NDArray[np.float64]
SIZE = 4
SEEDS = range(8)  # from 4 on, joints follow sums
CLOSE = {"qdd": 1e-10}
FEW = Reductions(trials=4)
EPSILON = float(np.finfo(float).eps)
STEP = DIGITS.literal(10) ** -15


@cache
def coupled_tree(seed: int) -> Tree:
    """Make one or two of four joints follow others: on their way to the base, beyond them, or beside them."""
    rng = np.random.default_rng(seed)
    tree = with_rotors(with_laws(random_tree(seed, SIZE, runtime=seed % 3 == 2)), seed)
    tree = with_wrenches(tree, seed) if seed % 2 else tree
    order = [int(i) + 1 for i in rng.permutation(SIZE)]
    count, sums = 1 + seed % 4 // 2, seed >= 4
    followers, leaders = order[:count], order[count:]
    bodies = [
        replace(b, joint=replace(b.joint, actuated=False)) if i in followers else b
        for i, b in enumerate(tree.bodies, 1)
    ]
    couplings = tuple(
        Coupling(
            i, int(rng.choice(leaders)), exact(rng.choice([-2.0, -1.0, 0.5, 1.0, 1.7])), exact(rng.choice([0, 0.4]))
        )
        for i in followers
    )
    return replace(tree, bodies=tuple(bodies), couplings=add_leaders(couplings, leaders) if sums else couplings)


def add_leaders(couplings: Sequence[Coupling], leaders: Sequence[int]) -> tuple[Coupling, ...]:
    """Make each follower follow all leaders."""
    ratios = [exact(x) for x in (0.3, -1.2, 0.7, 0.4, -0.9, 1.1, 0.6)]
    return tuple(
        replace(x, more=tuple(zip((i for i in leaders if i != x.leader), ratios, strict=False))) for x in couplings
    )


def couple_some(tree: Tree, seed: int, count: int, *, sums: bool = False) -> Tree:
    """Make some joints of a tree follow others; joints of quaternions neither follow nor are followed."""
    rng = np.random.default_rng(seed)
    inside = {i for x in tree.quaternions for i in x.bodies}
    order = [int(i) + 1 for i in rng.permutation(len(tree.bodies)) if int(i) + 1 not in inside]
    followers, leaders = order[:count], order[count:]
    bodies = [
        replace(b, joint=replace(b.joint, actuated=b.joint.actuated and i not in followers))
        for i, b in enumerate(tree.bodies, 1)
    ]
    ratios = [exact(x) for x in rng.choice([-2.0, -1.0, 0.5, 1.7], count)]
    couplings = tuple(
        Coupling(i, int(rng.choice(leaders)), x, exact(0.0)) for i, x in zip(followers, ratios, strict=True)
    )
    return replace(tree, bodies=tuple(bodies), couplings=add_leaders(couplings, leaders) if sums else couplings)


def map_of(tree: Tree) -> tuple[Array, Array]:
    """Make G and g of q = G y + g."""
    followers = {x.follower: x for x in tree.couplings}
    kept = [i for i in range(1, len(tree.bodies) + 1) if i not in followers]
    G, g = np.zeros((len(tree.bodies), len(kept))), np.zeros(len(tree.bodies))
    for i in range(1, len(tree.bodies) + 1):
        rule = followers.get(i, Coupling(i, i, exact(1.0), exact(0.0)))
        g[i - 1] = float(rule.offset)
        for leader, ratio in rule.terms:
            G[i - 1, kept.index(leader)] = float(ratio)
    return G, g


def draw(tree: Tree, tape_inputs: Mapping[str, int], seed: int) -> dict[str, Array]:
    rng = np.random.default_rng(seed + 40)
    drawn = {name: rng.uniform(-1, 1, size) for name, size in tape_inputs.items()}
    return drawn | {"p": np.array(values_of(tree))}


def compute(tape: Tape, given: Mapping[str, Array]) -> dict[str, Array]:
    values = evaluate(tape, {i.name: list(given[i.name]) for i in tape.inputs})
    results = {}
    for o in tape.outputs:
        results[o.name] = np.zeros((o.sparsity.rows, o.sparsity.cols))
        for place, value in zip(o.sparsity.entries, values[o.name], strict=True):
            results[o.name][place] = value
    return results


def assert_close(name: str, found: Array, expected: Array) -> None:
    size = max(1.0, float(np.abs(expected).max(initial=0.0)))
    np.testing.assert_allclose(found, expected, rtol=0, atol=CLOSE.get(name, 1e-12) * size)


@pytest.mark.parametrize("seed", [s for s in SEEDS if s % 2 == 0])
def test_the_equations_are_those_of_pinocchio_projected(seed: int) -> None:
    """Without wrenches: M, c and the residual, and the accelerations by both ways."""
    tree = coupled_tree(seed)
    G, g = map_of(tree)
    peer = Pinocchio(tree.uncoupled)
    names = ("impl", "semi", "semi_res", "exp1", "exp2")
    functions = {name: FUNCTIONS[name].build(tree, Options().reductions) for name in names}
    driven = [k for k, joint in enumerate(tree.joints) if joint.actuated]
    state = draw(tree, {"q": G.shape[1], "qd": G.shape[1], "qdd": G.shape[1], "u": len(driven)}, seed)
    q, qd = G @ state["q"] + g, G @ state["qd"]
    M, c = G.T @ peer.mass_matrix(q) @ G, G.T @ peer.residual(q, qd, 0 * q)
    Q = G.T @ law_forces(tree, q, qd)
    Q[driven] += state["u"]
    residual, qdd = M @ state["qdd"] + c - Q, np.linalg.solve(M, Q - c)
    expected = {"M": M} | {name: x[:, None] for name, x in (("c", c), ("Phi", residual), ("qdd", qdd))}
    for tape in functions.values():
        for name, found in compute(tape, state).items():
            assert_close(name, found, expected[name])


@pytest.mark.parametrize("seed", SEEDS)
def test_all_functions_are_those_of_the_uncoupled_tree_at_its_state(seed: int) -> None:
    """With open wrenches too. Accelerations make the residual vanish; what is not of joints is as it was."""
    tree = coupled_tree(seed)
    G, g = map_of(tree)
    n, forces = G.shape[1], 3 * sum(v is None for x in tree.wrenches for v in (x.force, x.moment))
    state = draw(tree, {"q": n, "qd": n, "qdd": n, "u": sum(j.actuated for j in tree.joints), "w": forces}, seed)
    whole = state | {"q": G @ state["q"] + g, "qd": G @ state["qd"], "qdd": G @ state["qdd"]}
    for name in ("impl", "semi", "semi_res", "sensors", "motion", "jacobian", "energy", "frames"):
        entry = FUNCTIONS[name]
        found = compute(entry.build(tree, Options().reductions), state)
        expected = compute(entry.build(tree.uncoupled, Options().reductions), whole)
        for result, value in expected.items():
            rows = G.T @ value if result in ("Phi", "c", "M") else value
            assert_close(result, found[result], rows @ G if result in ("M", "J") else rows)
    residual = FUNCTIONS["impl"].build(tree, Options().reductions)
    size = np.abs(compute(residual, state | {"qdd": 0 * state["qdd"]})["Phi"]).max()
    for name in ("exp1", "exp2"):
        qdd = compute(FUNCTIONS[name].build(tree, Options().reductions), state)["qdd"][:, 0]
        assert np.abs(compute(residual, state | {"qdd": qdd})["Phi"]).max() < 1e-10 * size


def differentiate(f: Callable[[Array], Array], at: Array) -> Array:
    columns = []
    for k in range(len(at)):
        step = np.array([STEP if i == k else DIGITS.literal(0) for i in range(len(at))], dtype=object)
        columns.append((f(at + step) - f(at - step)) / (2 * STEP))
    return np.array(columns, dtype=object).T


def compute_digits(tape: Tape, given: Mapping[str, Array]) -> dict[str, Array]:
    values = evaluate(tape, {i.name: list(given[i.name]) for i in tape.inputs}, DIGITS)
    results = {}
    for o in tape.outputs:
        full = np.array([[DIGITS.literal(0)] * o.sparsity.cols for _ in range(o.sparsity.rows)], dtype=object)
        for place, value in zip(o.sparsity.entries, values[o.name], strict=True):
            full[place] = value
        results[o.name] = full
    return results


@pytest.mark.parametrize(
    ("name", "seed"), [("impl", 3), ("exp1", 0), ("exp2", 3), ("motion", 1), ("impl", 7), ("exp1", 4)]
)
def test_derivatives_are_exact(name: str, seed: int) -> None:
    """Jacobians are slopes of values, and second derivatives slopes of adjoints."""
    families = write_families(coupled_tree(seed), Request(functions=(name,)))
    tapes = {tape.name: tape for family in families for tape in family.tapes}
    rng = np.random.default_rng(seed)
    digits = np.vectorize(DIGITS.literal, otypes=[object])
    sizes = {i.name: i.sparsity.nnz for tape in tapes.values() for i in tape.inputs}
    state = {key: digits(rng.uniform(0.2, 1, size)) if size else np.zeros(0, object) for key, size in sizes.items()}
    value, jac, adj1, second = (tapes[f"{order}{name}"] for order in ("", "jac_", "adj1_", "jac_adj1_"))
    for tape, slopes in ((value, jac), (adj1, second)):
        slopes_found = compute_digits(slopes, state)
        for x in (i.name for i in tape.inputs):
            for o in (o.name for o in tape.outputs):
                found = slopes_found.get(f"jac_{o}_{x}")
                if found is None:
                    continue

                def move(at: Array, o: str = o, x: str = x, tape: Tape = tape) -> Array:
                    return compute_digits(tape, {**state, x: at})[o].ravel(order="F")

                expected = differentiate(move, state[x])
                assert found.shape == expected.shape
                assert max(map(abs, (found - expected).ravel())) < 1e-13 * max(1, max(map(abs, expected.ravel())))


def finger(
    follows: tuple[str, float | str, float] | None, parameters: dict[str, float] | None = None, **setting: object
) -> Model:
    """Two fingers on a hand that floats freely: quaternions and couplings in one tree."""
    own: Setting = {**setting, "name": "b"}  # type: ignore[typeddict-item]
    if follows:
        own["follows"] = follows
    solid = {"mass": 1.0, "com": (0.1, 0.0, 0.2), "inertia": (0.1, 0.1, 0.1)}
    return make_model(
        "hand",
        [
            body("palm", free(), mass=2, inertia=(0.1, 0.2, 0.2)),
            body("one", revolute("y", name="a", position=(0.1, 0, 0)), parent="palm", **solid),  # type: ignore[arg-type]
            body("two", revolute("x", position=(-0.1, 0, 0), **own), parent="palm", **solid),  # type: ignore[arg-type]
        ],
        gravity=(0, 0, -9.81),
        parameters=parameters,
    )


def test_quaternions_stay_what_they_are() -> None:
    """A free hand whose fingers go together: the equations of the uncoupled hand, projected."""
    tree, apart = build_tree(finger(("a", -1.0, 0.1))), build_tree(finger(None, actuated=False))
    assert tree.coordinates == apart.coordinates[:-1]
    rng = np.random.default_rng(2)
    q, qd, qdd, u = rng.uniform(-1, 1, 8), rng.uniform(-1, 1, 7), rng.uniform(-1, 1, 7), rng.uniform(-1, 1, 1)
    G = np.vstack((np.eye(7), -np.eye(7)[6]))
    state = {"q": q, "qd": qd, "qdd": qdd, "u": u}
    whole = {"q": np.append(q, 0.1 - q[7]), "qd": G @ qd, "qdd": G @ qdd, "u": u}
    for name in ("impl", "semi", "rates"):
        found = compute(FUNCTIONS[name].build(tree, Options().reductions), state)
        expected = compute(FUNCTIONS[name].build(apart, Options().reductions), whole)
        for result, value in expected.items():
            projected = value[:-1] if result == "rate" else G.T @ value
            assert_close(result, found[result], projected @ G if result == "M" else projected)
    for name in ("exp1", "exp2"):
        own = compute(FUNCTIONS[name].build(tree, Options().reductions), state)["qdd"][:, 0]
        left = compute(FUNCTIONS["impl"].build(tree, Options().reductions), state | {"qdd": own})["Phi"]
        assert np.abs(left).max() < 1e-12


def test_a_written_model_is_read_as_the_same(tmp_path: Path) -> None:
    model = finger(("a", "-1/2", 0.1))
    (tmp_path / "hand.yaml").write_text(write_model(model))
    assert "follows: {joint: a, ratio: -1/2, offset: 0.1}" in (tmp_path / "hand.yaml").read_text()
    assert read_model(tmp_path / "hand.yaml") == model


def test_followers_of_a_locked_joint_are_locked_where_they_are_then() -> None:
    """Fixed at -0.5 * 0.4 + 0.1 = -0.1, as the uncoupled model is with both joints locked there."""
    coupled = build_tree(lock(finger(("a", "-1/2", 0.1)), {"a": Number(0.4)}))
    apart = build_tree(lock(finger(None, actuated=False), {"a": Number(0.4), "b": Number(-0.1)}))
    assert coupled.couplings == ()
    rng = np.random.default_rng(2)
    state = {"q": rng.uniform(-1, 1, 7), "qd": rng.uniform(-1, 1, 6), "qdd": rng.uniform(-1, 1, 6), "u": np.zeros(0)}
    found, expected = (compute(FUNCTIONS["impl"].build(t, Options().reductions), state) for t in (coupled, apart))
    assert_close("Phi", found["Phi"], expected["Phi"])


def test_limits_of_followers_bind_the_joint_that_they_follow() -> None:
    """q_b = -2 q_a + 0.1 within [-1, 2], and |q_b'| < 3: q_a within [-0.95, 0.55], |q_a'| < 1.5."""
    tree = build_tree(finger(("a", -2.0, 0.1), limits=(-1, 2), max_speed=3))
    leader = tree.joints[6]
    assert (leader.name, leader.max_speed) == ("a", 1.5)
    assert (leader.lower, leader.upper) == pytest.approx((-0.95, 0.55))


def test_a_follower_of_a_follower_goes_by_the_first() -> None:
    chain = [
        body("1", revolute("z", name="a"), mass=1, com=(0.1, 0, 0)),
        body("2", revolute("z", name="b", follows=("c", 2, 0.5)), parent="1", mass=1, com=(0.1, 0, 0)),
        body("3", revolute("z", name="c", follows=("a", 3, 0.25)), parent="2", mass=1, com=(0.1, 0, 0)),
    ]
    tree = build_tree(make_model("chain", chain, gravity=(0, -9.81, 0)))
    assert tree.couplings == (Coupling(2, 1, exact(6.0), exact(1.0)), Coupling(3, 1, exact(3.0), exact(0.25)))
    assert tree.coordinates == ("a",)


@pytest.mark.parametrize(
    ("follows", "finding"),
    [
        (("a", 0, 0), "a ratio of 0"),
        (("x", 1, 0), 'there is no joint "x"'),
        (("b", 1, 0), "follows itself"),
        (("palm.rx", 1, 0), "quaternion"),
    ],
)
def test_what_cannot_follow_is_refused(follows: tuple[str, float, float], finding: str) -> None:
    with pytest.raises(InputError, match=finding):
        finger(follows)


def test_limits_that_leave_no_place_are_refused() -> None:
    with pytest.raises(InputError, match="leave the joint no range"):
        make_model(
            "shut",
            [
                body("1", revolute("z", name="a", limits=(0, 1)), mass=1, com=(0.1, 0, 0)),
                body("2", revolute("z", name="b", limits=(0, 1), follows=("a", 1, 5)), mass=1, com=(0.1, 0, 0)),
            ],
            gravity=(0, 0, 0),
        )


@pytest.mark.parametrize("sums", [False, True])
@pytest.mark.parametrize("ratio", [1, 10**6])
@pytest.mark.parametrize("seed", range(3))
def test_no_error_is_larger_than_condition_estimates(seed: int, ratio: int, sums: bool) -> None:
    """Chains of eight with a light or a heavy tip: EXP1 errs as estimated, EXP2 by no more.

    An error may be some times epsilon times the estimate, and 1e-14 beside it. The larger of two errors of EXP1 is
    not far below.
    """
    tree = couple_some(spatial_chain(8, [1] * 7 + [ratio]), seed, 1 + seed, sums=sums)
    tapes = {name: FUNCTIONS[name].build(tree, FEW) for name in ("exp1", "exp2", "condition")}
    sizes = {"q": len(tree.joints), "qd": len(tree.joints), "u": sum(joint.actuated for joint in tree.joints)}
    shares = []
    for state in (draw(tree, sizes, seed + k) for k in (0, 10)):
        estimates = compute(tapes["condition"], state)
        for name, estimate in (("exp1", "elimination"), ("exp2", "articulated")):
            given = {i.name: list(map(DIGITS.literal, state[i.name])) for i in tapes[name].inputs}
            expected = np.array(list(map(float, evaluate(tapes[name], given, DIGITS)["qdd"])))
            error = np.abs(compute(tapes[name], state)["qdd"][:, 0] - expected).max() / np.abs(expected).max()
            told = EPSILON * estimates[estimate].max()
            assert error <= 16 * told + 1e-14
            if name == "exp1":
                shares.append(error / told)
    assert max(shares) >= 1 / 50


def test_a_tolerance_is_kept_where_joints_follow_others() -> None:
    """Cuts are judged by the equations of the coupled tree: the residual keeps the tolerance at other states."""
    tree = couple_some(build_tree(random_model(1, 4)), 0, 1)
    options = Options(functions=("impl", "semi"), reductions=replace(FEW, factor=False))
    found = approximate(tree, 0.05, merge(options, EVERYTHING))
    assert found.taken
    states = draw_states(tree, 50, 77)
    states["u"] = np.zeros((50, sum(joint.actuated for joint in tree.joints)))

    def residuals(tree: Tree) -> Array:
        tape, values = FUNCTIONS["impl"].build(tree, FEW), {"p": np.array(values_of(tree))}
        given = [values | {name: entries[k] for name, entries in states.items()} for k in range(50)]
        return np.array([compute(tape, state)["Phi"][:, 0] for state in given])

    expected = residuals(tree)
    assert (np.abs(residuals(found.tree) - expected).max(axis=0) <= 0.05 * np.abs(expected).max(axis=0)).all()


def test_bounds_that_would_change_at_run_time_are_refused() -> None:
    """They would bind the other joint by a number that the manifest does not know."""
    with pytest.raises(
        InputError, match=r"joint\.max_speed: .* ratio that may change at run time; bound the other joint"
    ):
        make_model(
            "geared",
            [
                body("1", revolute("z", name="a"), mass=1, com=(0.1, 0, 0)),
                body("2", revolute("z", name="b", max_speed=1, follows=("a", "r", 0)), mass=1, com=(0.1, 0, 0)),
            ],
            gravity=(0, 0, 0),
            parameters={"r": runtime(2)},
        )


_SOLID = "mass: 1, com: [0.1, 0, 0.2], inertia: [0.1, 0.1, 0.1]"
_LINKED = {
    "a follower": "{name: b, type: revolute, axis: x, follows: {joint: a, ratio: -k/2, offset: k/5}}",
    "a screw": "{name: b, type: helical, axis: x, pitch: k/5}",
    "a follower with limits": "{name: b, type: revolute, axis: x, follows: {joint: a, ratio: -k/2}, limits: [-k, k]}",
    "a constraint": "{name: b, type: revolute, axis: x, actuated: false}",
    "limits alone": "{name: b, type: revolute, axis: x, limits: [-0.1, k]}",
}


@pytest.mark.parametrize("linked", _LINKED)
def test_constants_of_rules_and_limits_change_everywhere_or_stay(linked: str, tmp_path: Path) -> None:
    """With all numbers at run time, `k` is a parameter that the rule reads, or a constant that it needs."""
    path = tmp_path / "hand.yaml"

    def read(k: float) -> Model:
        lines = [
            f"name: hand\ngravity: [0, 0, -9.81]\nparameters: {{k: {k}}}\nbodies:",
            f"  - {{name: one, joint: {{name: a, type: revolute, axis: y}}, {_SOLID}}}",
            f"  - {{name: two, parent: one, joint: {_LINKED[linked]}, {_SOLID}}}",
            "  - {name: end, parent: two, joint: {name: c, type: revolute, axis: z}, mass: k, com: [0, 0.1, 0]}",
            *(["constraints:", "  - {name: rule, equation: 2*b + k*a}"] if linked == "a constraint" else []),
        ]
        path.write_text("\n".join(lines), "utf-8")
        return read_model(path)

    loose, other = build_tree(with_runtime_numbers(read(1.5))), build_tree(read(1.2))
    parameters = {p.name: p.value for p in loose.parameters if p.kind is Kind.RUNTIME}
    assert ("k" in parameters) is (linked in ("a follower", "a screw", "limits alone"))
    if "k" in parameters:
        n = len(other.coordinates)
        state = {"q": np.linspace(0.2, 0.9, n), "qd": np.linspace(1, -1, n), "u": np.linspace(0.1, 0.5, n)}
        values = state | {"p": np.array([*(parameters | {"k": 1.2}).values()])}
        for name in ("semi", "exp1", "exp2"):
            expected = compute(FUNCTIONS[name].build(other, Options().reductions), state)
            found = compute(FUNCTIONS[name].build(loose, Options().reductions), values)
            for result, value in expected.items():
                assert_close(result, found[result], value)


def test_a_whole_folder_is_written_and_agrees_with_itself(tmp_path: Path, requires: Requires) -> None:
    """The report counts every formulation, and the check program that comes with the C finds no fault."""
    arm = [
        body("1", revolute("z", name="a"), mass=1, com=(0.1, 0, 0)),
        body("2", revolute("y", name="b", follows=("a", -1, 0.5)), parent="1", mass=1, com=(0.1, 0, 0)),
    ]
    model = make_model("arm", arm, gravity=(0, -9.81, 0), frames=[frame("tip", "2", position=(0, 0, 0.2))])
    files = make(model, Options(derivatives=1)).files
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    assert "EXP2" in files["report.md"]
    run(requires("gcc"), "-std=c99", "-O0", *sorted(tmp_path.glob("*.c")), "-lm", "-o", tmp_path / "check")
    assert " 0 of " in f" {run(tmp_path / 'check')}".replace("\n", "\n ")
