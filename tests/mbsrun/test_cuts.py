"""Every kind of cut against the tree that has the same joint: motions, and optima of both forms.

An arm hangs on a crank by a joint. In the tree the joint is a joint; in the other model the arm is free, and a cut of
that kind ties it to the crank. A rod is a universal joint, a bar without mass, and a ball.

Half of the cuts tie a free body, with a quaternion, and half a floating one, of six joints: the reduced form takes no
quaternion whose velocities depend on others in part.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mbsrun import Mechanism, load
from mbsrun.models import Extent, find_folder
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.problem.problem import Loops
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.resimulation import resimulate
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.statement import state_problem
from mbsrun.simulation import Formulation, Keeping, Settings, simulate
from mbsrun.simulation.drive import hold

Array = NDArray[np.float64]
State = tuple[Array, Array]

CRANK = """\
gravity: [0.5, -0.3, -3]
bodies:
  - {name: crank, joint: {type: revolute, axis: y, position: [0, 0, 0.2], damping: 0.1}, mass: 1.2,
     com: [0.2, 0.02, 0.05], inertia: [0.02, 0.03, 0.04]}
"""
MASS = "mass: 0.8, com: [0.1, 0.03, -0.05], inertia: {xx: 0.2, yy: 0.3, zz: 0.25, xy: 0.02, xz: -0.01}"
PLACE = "position: [0.4, 0.05, 0.1], orientation: [{axis: x, angle: 0.4}, {axis: z, angle: -0.3}]"
REST = """\
forces:
  - {name: spring, from: {body: base, position: [0.3, 0.4, 0.9]}, to: {body: arm, position: [0.1, 0.1, 0.3]},
     stiffness: 30, rest: 0.2, damping: 0.5}
frames:
  - {name: tip, body: arm, position: [0.3, 0.1, 0.2]}
  - {name: seat, body: arm}
"""
AXIS, ACROSS, LENGTH = "[0, 0.6, 0.8]", "[1, 0, 0]", 0.35
JOINTS = {  # the joint of the tree, and the further fields of the cut
    "ball": ("type: ball", ""),
    "hinge": (f"type: revolute, axis: {AXIS}", f", axis: {AXIS}"),
    "universal": (f"type: universal, axis: {AXIS}, axis2: {ACROSS}", f", axis: {AXIS}, axis2: {ACROSS}"),
    "cylindrical": (f"type: cylindrical, axis: {AXIS}", f", axis: {AXIS}"),
    "helical": (f"type: helical, axis: {AXIS}, pitch: 0.07", f", axis: {AXIS}, pitch: 0.07"),
    "prismatic": (f"type: prismatic, axis: {AXIS}", f", axis: {AXIS}"),
    "planar": (f"type: planar, normal: {AXIS}", f", axis: {AXIS}"),
    "solid": ("type: fixed", ""),
    "rod": ("", f", length: {LENGTH}"),
}
FLOATING = ("hinge", "universal", "helical", "planar", "ball")  # the cuts of a floating arm; the others' arm is free
VALUES = ("energy", "power")  # needed without derivatives, to simulate
TREE, CUT = ("exp1", "motion"), ("exp2", "semi", "semi_res")  # by the tree, and by the model with a cut
DIFFERENTIATED = ("impl", "frames", "sensors")
LOOPS = ("loops", "loop_rates", "loop_jacobian", "loop_forces")
FLOATS, FLIES = ("impl_red", "exp1_red"), ("exp2",)  # differentiated, too: by the joint of the arm
WAYS: Mapping[str, dict[str, Any]] = {
    "projection": {"formulation": Formulation.EXP2, "rtol": 1e-10, "atol": 1e-10},
    "mass-projection": {
        "loops": Keeping.MASS_PROJECTION,
        "formulation": Formulation.SEMI,
        "rtol": 1e-10,
        "atol": 1e-10,
    },
    "radau-iia": {"method": "radau-iia", "formulation": Formulation.IMPL, "step": 5e-3, "stages": 3},
    "variational": {"method": "variational", "formulation": Formulation.IMPL, "step": 1e-3},
    "generalized-alpha": {"method": "generalized-alpha", "formulation": Formulation.IMPL, "step": 1e-3},
}
ORDER_2 = 1e-4  # how far the tip may be off by methods of order 2 [m]
EXACT = 1e-8  # and by the others
TIME, MOMENT = 0.3, 0.3


def write_tree(kind: str) -> str:
    """Write the model with a joint."""
    if kind == "rod":
        arms = f"""\
  - {{name: bar, parent: crank, joint: {{type: universal, axis: x, axis2: y, {PLACE}, actuated: false}}}}
  - {{name: arm, parent: bar, joint: {{type: ball, position: [0, 0, {LENGTH}], actuated: false}}, {MASS}}}
"""
    else:
        passive = "" if kind == "solid" else ", actuated: false"
        arms = f"  - {{name: arm, parent: crank, joint: {{{JOINTS[kind][0]}, {PLACE}{passive}}}, {MASS}}}\n"
    return f"name: tree_{kind}\n{CRANK}{arms}{REST}"


def write_cut(kind: str) -> str:
    """Write the model with a cut."""
    return f"""\
name: cut_{kind}
{CRANK}  - {{name: arm, joint: {{type: {find_base(kind)}, actuated: false}}, {MASS}}}
loops:
  - {{name: joint, type: {kind}, from: {{body: crank, {PLACE}}}, to: {{body: arm}}{JOINTS[kind][1]}}}
{REST}"""


@pytest.fixture(autouse=True, scope="module")
def compile_quickly() -> Iterator[None]:
    """Compile without optimisations, which take longer than the motions."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CFLAGS", "-O0")
        yield


def find_base(kind: str) -> str:
    """Return the type of the joint by which the arm of a model with a cut moves."""
    return "floating" if kind in FLOATING else "free"


@cache
def make(text: str) -> Mechanism:
    """Generate what simulations and problems need, in one folder: most of the time goes there."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "model.yaml"
        file.write_text(text, "utf-8")
        values, differentiated = (*VALUES, *TREE), DIFFERENTIATED
        if "loops:" in text:
            own = (*FLIES, "exp1") if "type: rod" in text else FLOATS if "floating" in text else FLIES
            differentiated = (*DIFFERENTIATED, *LOOPS, *own)
            values = tuple({*VALUES, *CUT} - {*differentiated})
        extent = Extent((*values, *differentiated), optional=("rates",), values=values)
        return load(find_folder(file, extent))


def draw(tree: Mechanism, speed: float) -> State:
    """Draw a state of the tree."""
    rng, names = np.random.default_rng(5), tree.manifest.positions
    q, qd = rng.uniform(-0.5, 0.5, len(names)), rng.uniform(-speed, speed, len(tree.manifest.coordinates))
    for i in [i for i, name in enumerate(names) if name.endswith(".qw")]:
        q[i - 3 : i + 1] = Rotation.from_rotvec([0.3, -0.2, 0.4]).as_quat()
    return q, qd


def carry(tree: Mechanism, state: State, base: str) -> State:
    """Return the state of the model with the cut: the arm is where the tree has it."""
    q, qd = state
    frames, motion = tree.frames(q=q), tree.motion(q=q, qd=qd)
    k = [frame.name for frame in tree.manifest.frames].index("seat")
    p, R = frames["p"].reshape(3, -1)[:, k], frames["R"].reshape(3, -1)[:, 3 * k : 3 * k + 3]
    k = [frame.name for frame in tree.manifest.frames if frame.sensor].index("seat")
    v, omega = (motion[name].reshape(3, -1)[:, k] for name in ("v", "omega"))
    turn = Rotation.from_matrix(R)
    if base == "free":
        return np.array([q[0], *p, *turn.as_quat()]), np.array([qd[0], *(R.T @ v), *(R.T @ omega)])
    z, y, x = turn.as_euler("ZYX")
    Ry, Rx = (Rotation.from_euler(axis, angle).as_matrix() for axis, angle in (("y", y), ("x", x)))
    axes = np.column_stack([Rx.T @ Ry.T @ [0, 0, 1], Rx.T @ [0, 1, 0], [1, 0, 0]])
    return np.array([q[0], *p, z, y, x]), np.array([qd[0], *v, *np.linalg.solve(axes, R.T @ omega)])


def find_tip(mechanism: Mechanism, q: Array) -> Array:
    """Return the place of the arm's tip."""
    k = [frame.name for frame in mechanism.manifest.frames].index("tip")
    return np.asarray(mechanism.frames(q=q)["p"].reshape(3, -1)[:, k])


@cache
def fly(kind: str) -> Array:
    """Integrate the tree, and return where its tip is in the end."""
    tree = make(write_tree(kind))
    settings = Settings(TIME, formulation=Formulation.EXP1, rtol=1e-11, atol=1e-11)
    motion = simulate(tree, hold([MOMENT]), *draw(tree, 0.6), settings)
    assert motion.is_complete
    return find_tip(tree, motion.q[-1])


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("kind", JOINTS)
def test_a_cut_moves_as_its_joint(requires: Callable[[str], str], kind: str, way: str) -> None:
    requires("cc")
    tree, cut = make(write_tree(kind)), make(write_cut(kind))
    q, qd = carry(tree, draw(tree, 0.6), find_base(kind))
    motion = simulate(cut, hold([MOMENT]), q, qd, Settings(TIME, output_step=0.05, **WAYS[way]))
    assert motion.is_complete, motion.halt
    rough = way in ("variational", "generalized-alpha")
    assert find_tip(cut, motion.q[-1]) == pytest.approx(fly(kind), abs=ORDER_2 if rough else EXACT)
    assert np.abs(cut.loops(q=motion.q)["gap"]).max() < 1e-10


TASK: Mapping[str, Any] = {
    "horizon": 0.25,
    "intervals": 4,
    "scheme": "radau",
    "degree": 4,
    "solver": {"tolerance": 1e-10},
    "guess": {"motion": "rest", "inputs": "zero"},
    "cost": {"inputs": 1, "running": [{"expression": "z_tip**2", "weight": 20}]},
}


def optimise(plant: Mechanism, state: State, guess: Trajectory | None = None, **more: Any) -> Solution:
    """Turn the crank by 0.05 rad with the least cost, from a state."""
    start = {key: [float(x) for x in part] for key, part in zip(("pose", "velocity"), state, strict=True)}
    end = {"pose": {"crank": start["pose"][0] + 0.05}}
    found = solve(
        state_problem({**TASK, "start": start, "end": end, **more}, "turn", plant, Path()), plant, guess=guess
    )
    assert isinstance(found, Solution), found
    return found


REDUCED: tuple[dict[str, Any], ...] = (
    {"loops": "reduced"},
    {"loops": "reduced", "form": "integral"},
    {"loops": "reduced", "form": "shooting"},
    {"loops": "reduced", "representation": "EXP1-O"},
)
MULTIPLIERS: tuple[dict[str, Any], ...] = (
    {"loops": "multipliers"},
    {"loops": "multipliers", "representation": "EXP2-A"},
)


def list_forms(kind: str) -> tuple[dict[str, Any], ...]:
    """List the forms of a cut's problem; second derivatives of explicit ones take longest to write."""
    if kind == "rod":
        return (*MULTIPLIERS, {"loops": "multipliers", "representation": "EXP1-O"})
    return REDUCED if kind in FLOATING else MULTIPLIERS


@pytest.mark.parametrize("kind", JOINTS)
def test_a_cut_has_the_optimum_of_its_joint(requires: Callable[[str], str], kind: str) -> None:
    """Coordinates differ, so costs do by the error of the discretisation; loops are closed to rounding."""
    requires("cc")
    tree, cut = make(write_tree(kind)), make(write_cut(kind))
    state = draw(tree, 0.0)
    expected = optimise(tree, state).cost.total
    guess: Trajectory | None = None
    for form in list_forms(kind):  # from the motion of the first, since an arm on a plane is far from rest in the end
        found = resimulate(optimise(cut, carry(tree, state, find_base(kind)), guess, **form), cut)
        guess = guess or found.trajectory
        assert found.problem.loops is Loops(form["loops"])
        assert found.cost.total == pytest.approx(expected, rel=2e-5), form
        check = found.resimulation
        assert check is not None
        for gap in (found.violation.closure, check.closure):
            assert gap is not None
            assert gap < 1e-10
