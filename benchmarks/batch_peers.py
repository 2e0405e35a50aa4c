"""Peers' batches of the same mechanism: `python -m benchmarks.batch_peers PEER MODEL` prints times in ns a state.

Each peer gets the tree of a model file as it reads mechanisms: Pinocchio a model of joints and bodies, MuJoCo its XML,
JaxSim SDF, adam and frax URDF, with a fixed base; CasADi traces Pinocchio's algorithms. One thread
computes `impl` (inverse dynamics) and `exp2` (forward dynamics) for 8192 states, into new arrays where the peer makes
them. Results are compared with the kernels' before they count. MuJoCo's rollout takes steps by Euler's method, which
contain forward dynamics. adam has no inverse dynamics with accelerations, and no fixed base: `impl` is its bias force,
which leaves the product with the mass matrix out; `exp2` solves with its mass matrix.
"""

from __future__ import annotations

import ctypes
import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import mbsrun
from benchmarks.compilation import Workshop, find_cache, find_includes
from benchmarks.loops.mechanism import write_xml
from benchmarks.mechanism import write_mechanism
from benchmarks.preparation import load_mechanism, trace
from mbsgen.model.tree import Body, Motion, Tree
from mbsgen.pipeline import read_tree
from mbsrun import Mechanism
from mbsrun.measuring.timing import Pool, load_timing
from mbsrun.models import Extent

Numbers = NDArray[np.float64]
STATES, CALLS = 8192, 10
AGREE = 1e-7  # of results, relative to the largest
STEPS = 64  # of a motion in a rollout
FREE = '<option timestep="1e-4"><flag contact="disable" constraint="disable" eulerdamp="disable"/></option>'
FUNCTIONS = ("impl", "exp2")


@dataclass(frozen=True)
class Task:
    """A function of a mechanism in many states; arrays have a row for each."""

    tree: Tree
    function: str
    q: Numbers
    qd: Numbers
    last: Numbers  # accelerations, or the forces of all joints
    folder: Path

    @property
    def states(self) -> tuple[Numbers, Numbers, Numbers]:
        """Return all arrays."""
        return self.q, self.qd, self.last


Compute = Callable[[], Numbers | None]  # a row for each state, or nothing to compare
Prepare = Callable[[Task], tuple[Compute, int]]  # and how many states a call computes


# --- in C and C++ --------------------------------------------------------------------------------------------------


def prepare_pinocchio(task: Task) -> tuple[Compute, int]:
    """Prepare the batches of Pinocchio's package, in one thread."""
    import pinocchio as pin

    model, values = pin.Model(), {p.symbol: p.value for p in task.tree.parameters}
    model.gravity.linear = _numbers(task.tree.gravity, values)
    for number, body in enumerate(task.tree.bodies, 1):
        kind = "R" if body.joint.motion is Motion.REVOLUTE else "P"
        joint = getattr(pin, f"JointModel{kind}{'XYZ'[body.joint.axis]}")()
        place = pin.SE3(_numbers(body.orientation, values), _numbers(body.position, values))
        assert model.addJoint(body.parent, joint, place, f"j{number}") == number
        matter = pin.Inertia(
            float(_numbers(body.mass, values)), _numbers(body.com, values), _numbers(body.inertia, values)
        )
        model.appendBodyToJoint(number, matter, pin.SE3.Identity())
    pool = pin.ModelPool(model, 1)
    compute = {"impl": pin.rneaInParallel, "exp2": pin.abaInParallel}[task.function]
    columns = [np.asfortranarray(x.T) for x in task.states]
    found = np.zeros_like(columns[0])
    arguments = (1, pool, *columns, found)

    def run() -> Numbers:
        compute(*arguments)
        return found.T

    return run, STATES


def prepare_pinocchio_native(task: Task) -> tuple[Compute, int]:
    """Prepare Pinocchio's algorithms in C++, compiled for this processor, in a loop."""
    library = _make_workshop().compile_pinocchio("libm")
    load_mechanism(library, _write_mechanism(task))
    arrays, found = _lay(task)
    arg, res = (
        (ctypes.c_void_p * len(arrays))(*(a.ctypes.data for a in arrays)),
        (ctypes.c_void_p * 1)(found.ctypes.data),
    )
    steps = np.array([a.shape[1] for a in arrays], dtype=np.int64)
    address = ctypes.cast(getattr(ctypes.CDLL(str(library)), f"pin_{task.function}"), ctypes.c_void_p).value or 0
    given, results = ctypes.addressof(arg), ctypes.addressof(res)
    pool = Pool(STATES, len(arrays), given, steps.ctypes.data, results, None, None, address)
    timing = load_timing()

    def run() -> Numbers:
        kept = arrays, arg, res
        if timing(ctypes.addressof(pool), 1) < 0 or not kept:
            raise ArithmeticError("Pinocchio fails in one of the states")
        return found[:1]  # the loop writes to one place, where the last state's result is then

    return run, STATES


def prepare_casadi(task: Task) -> tuple[Compute, int]:
    """Prepare a map of a function that CasADi writes as C, compiled for this processor."""
    workshop = _make_workshop()
    function = trace(workshop, _write_mechanism(task), lambda _: None)[task.function]
    name = f"mapped_{task.function}"
    mapped = function.map(name, "serial", STATES, [], [])
    source = task.folder / f"{name}.c"
    here = Path.cwd()
    os.chdir(task.folder)
    try:
        mapped.generate(source.name, {"with_header": False})
    finally:
        os.chdir(here)
    library = workshop.compile_c(source, name, ("-O3", "-march=native"))
    arrays, found = _lay(task)
    arg = (ctypes.c_void_p * int(mapped.sz_arg()))(*(a.ctypes.data for a in arrays))
    res = (ctypes.c_void_p * int(mapped.sz_res()))(found.ctypes.data)
    iw, w = np.zeros(int(mapped.sz_iw()) + 1, dtype=np.int64), np.zeros(int(mapped.sz_w()) + 1)
    places = (arg, res, ctypes.c_void_p(iw.ctypes.data), ctypes.c_void_p(w.ctypes.data), 0)
    call = getattr(ctypes.CDLL(str(library)), name)

    def run() -> Numbers:
        kept = arrays, iw, w
        if call(*places) or not kept:
            raise ArithmeticError(f"{name} fails in one of the states")
        return found

    return run, STATES


def _lay(task: Task) -> tuple[list[Numbers], Numbers]:
    """Return the inputs of a function in CasADi's contract, and room for its result."""
    actuated = [i for i, body in enumerate(task.tree.bodies) if body.joint.actuated]
    forces = np.zeros((STATES, len(actuated)))
    last = [task.last, forces] if task.function == "impl" else [np.ascontiguousarray(task.last[:, actuated])]
    return [task.q, task.qd, *last], np.zeros_like(task.q)


def prepare_mujoco(task: Task) -> tuple[Compute, int]:
    """Prepare MuJoCo's rollout in this thread; inverse dynamics has no batch."""
    import mujoco
    from mujoco import rollout

    if task.function == "impl":
        raise NotImplementedError("no batch of inverse dynamics")
    text = write_xml(task.tree).replace("<worldbody>", f"{FREE}<worldbody>", 1)
    model = mujoco.MjModel.from_xml_string(text)
    data, motions = mujoco.MjData(model), STATES // STEPS
    size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    start = np.zeros((motions, size))
    start[:, 1 : 1 + 2 * model.nv] = np.hstack([task.q[:motions], task.qd[:motions]])
    forces = np.repeat(task.last[:motions, None, :], STEPS, axis=1)
    kind = int(mujoco.mjtState.mjSTATE_QFRC_APPLIED)
    states, sensors = np.zeros((motions, STEPS, size)), np.zeros((motions, STEPS, model.nsensordata))

    def run() -> Numbers | None:
        rollout.rollout(
            model, data, start, forces, control_spec=kind, state=states, sensordata=sensors, skip_checks=False
        )
        found = (states[:, 0, 1 + model.nv : 1 + 2 * model.nv] - task.qd[:motions]) / model.opt.timestep
        return np.asarray(found)

    return run, motions * STEPS


# --- in JAX --------------------------------------------------------------------------------------------------------


def prepare_frax(task: Task) -> tuple[Compute, int]:
    """Prepare frax's functions."""
    jnp = _set_up_jax().numpy
    names = tuple(f"j{k}" for k in range(1, len(task.tree.bodies) + 1))
    robot = import_module("frax.core.robot").Robot(str(_write_urdf(task)), joint_ordering=names)
    gravity = jnp.array([0.0, 0.0, 9.81, 0.0, 0.0, 0.0])
    functions: Mapping[str, Callable[..., Any]] = {
        "impl": lambda q, qd, qdd: robot.rnea(q, qd, qdd, gravity, None),
        "exp2": lambda q, qd, Q: robot.forward_dynamics(q, qd, Q, None),
    }
    return _prepare_jax(task, functions[task.function])


def prepare_jaxsim(task: Task) -> tuple[Compute, int]:
    """Prepare JaxSim's functions."""
    if any(body.mass == 0 for body in task.tree.bodies):
        raise NotImplementedError("it takes no bodies without mass")
    _set_up_jax()
    js = import_module("jaxsim.api")
    model = js.model.JaxSimModel.build_from_model_description(write_sdf(task.tree), gravity=9.81)
    names = [f"j{k}" for k in range(1, len(task.tree.bodies) + 1)]
    order = np.array([names.index(name) for name in model.joint_names()])
    back = np.argsort(order)

    def data(q: Any, qd: Any) -> Any:
        return js.data.JaxSimModelData.build(model=model, joint_positions=q[order], joint_velocities=qd[order])

    functions: Mapping[str, Callable[..., Any]] = {
        "impl": lambda q, qd, qdd: js.model.inverse_dynamics(model, data(q, qd), joint_accelerations=qdd[order])[1][
            back
        ],
        "exp2": lambda q, qd, Q: js.model.forward_dynamics(model, data(q, qd), joint_forces=Q[order])[1][back],
    }
    return _prepare_jax(task, functions[task.function])


def prepare_adam(task: Task) -> tuple[Compute, int]:
    """Prepare adam's bias force, and a solution with its mass matrix."""
    if any(body.joint.motion is Motion.PRISMATIC for body in task.tree.bodies):
        raise NotImplementedError("it takes no sliding joints")
    jnp = _set_up_jax().numpy
    names = [f"j{k}" for k in range(1, len(task.tree.bodies) + 1)]
    robot = import_module("adam.jax").KinDynComputations(
        str(_write_urdf(task)), names, gravity=jnp.array([0.0, 0.0, -9.81, 0.0, 0.0, 0.0])
    )
    base, still = jnp.eye(4), jnp.zeros(6)

    def find_bias(q: Any, qd: Any) -> Any:
        return robot.bias_force(base, q, still, qd)[6:]

    def accelerate(q: Any, qd: Any, Q: Any) -> Any:
        return jnp.linalg.solve(robot.mass_matrix(base, q)[6:, 6:], Q - find_bias(q, qd))

    if task.function == "impl":
        run, states = _prepare_jax(task, lambda q, qd, _: find_bias(q, qd))

        def start() -> None:
            run()

        return start, states
    return _prepare_jax(task, accelerate)


def _set_up_jax() -> Any:
    import jax

    jax.config.update("jax_enable_x64", True)
    return jax


def _prepare_jax(task: Task, function: Callable[..., Any]) -> tuple[Compute, int]:
    jax = _set_up_jax()
    compute, states = jax.jit(jax.vmap(function)), [jax.numpy.asarray(x) for x in task.states]
    return lambda: np.asarray(compute(*states)), STATES


PEERS: Mapping[str, Prepare] = {
    "Pinocchio's batch": prepare_pinocchio,
    "Pinocchio, native": prepare_pinocchio_native,
    "CasADi's map": prepare_casadi,
    "MuJoCo's rollout": prepare_mujoco,
    "frax": prepare_frax,
    "JaxSim": prepare_jaxsim,
    "adam": prepare_adam,
}


# --- mechanisms ----------------------------------------------------------------------------------------------------


def _make_workshop() -> Workshop:
    return Workshop(find_cache(), includes=find_includes())


def _write_mechanism(task: Task) -> Path:
    path = task.folder / "mechanism.txt"
    path.write_text(write_mechanism(task.tree), encoding="utf-8")
    return path


def _numbers(entries: Any, values: Mapping[Any, float]) -> Numbers:
    """Return expressions as numbers, in the shape that they have."""
    if isinstance(entries, tuple):
        return np.array([_numbers(entry, values) for entry in entries])
    return np.array(float(entries.subs(values)) if hasattr(entries, "subs") else float(entries))


@dataclass(frozen=True)
class Link:
    """A body and its joint, as formats write their numbers."""

    kind: str
    parent: int  # 0 is the base
    place: str
    turn: str  # roll, pitch, yaw
    axis: str
    mass: str
    com: str
    inertia: Mapping[str, str]  # by the axes


def list_links(tree: Tree) -> list[Link]:
    """Return the bodies of a mechanism."""
    values = {p.symbol: p.value for p in tree.parameters}
    pairs = {"xx": (0, 0), "yy": (1, 1), "zz": (2, 2), "xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}

    def text(entries: Any) -> str:
        return " ".join(repr(float(x)) for x in np.atleast_1d(_numbers(entries, values)))

    def describe(body: Body) -> Link:
        kind = "revolute" if body.joint.motion is Motion.REVOLUTE else "prismatic"
        turn = Rotation.from_matrix(_numbers(body.orientation, values)).as_euler("xyz")
        I = _numbers(body.inertia, values)
        return Link(
            kind,
            body.parent,
            text(body.position),
            text(tuple(turn)),
            text(tuple(np.eye(3)[body.joint.axis])),
            text(body.mass),
            text(body.com),
            {name: repr(float(I[place])) for name, place in pairs.items()},
        )

    return [describe(body) for body in tree.bodies]


def write_urdf(tree: Tree) -> str:
    """Write a mechanism as URDF, its base fixed to the link world."""

    def write(number: int, link: Link) -> Iterator[str]:
        parent = f"link{link.parent}" if link.parent else "world"
        entries = " ".join(f'i{name}="{value}"' for name, value in link.inertia.items())
        yield f'<link name="link{number}"><inertial><origin xyz="{link.com}" rpy="0 0 0"/>'
        yield f'<mass value="{link.mass}"/><inertia {entries}/></inertial></link>'
        yield f'<joint name="j{number}" type="{link.kind}"><parent link="{parent}"/><child link="link{number}"/>'
        yield f'<origin xyz="{link.place}" rpy="{link.turn}"/>'
        yield f'<axis xyz="{link.axis}"/>'
        yield '<limit lower="-100" upper="100" effort="1e6" velocity="1e6"/></joint>'

    parts = [line for number, link in enumerate(list_links(tree), 1) for line in write(number, link)]
    entries = " ".join(f'i{name}="{int(name[0] == name[1])}"' for name in ("xx", "yy", "zz", "xy", "xz", "yz"))
    matter = f'<inertial><origin xyz="0 0 0" rpy="0 0 0"/><mass value="1"/><inertia {entries}/></inertial>'
    head = f'<robot name="{tree.name}"><link name="world">{matter}</link>'  # which all of these readers want
    return "\n".join([head, *parts, "</robot>"]) + "\n"


def write_sdf(tree: Tree) -> str:
    """Write a mechanism as SDF, its base fixed to the world."""

    def write(number: int, link: Link) -> Iterator[str]:
        parent = f"link{link.parent}"
        entries = "".join(f"<i{name}>{value}</i{name}>" for name, value in link.inertia.items())
        yield f'<joint name="j{number}" type="{link.kind}"><parent>{parent}</parent><child>link{number}</child>'
        yield f'<pose relative_to="{parent}">{link.place} {link.turn}</pose>'
        yield f"<axis><xyz>{link.axis}</xyz><limit><lower>-100</lower><upper>100</upper>"
        yield "</limit></axis></joint>"
        yield f'<link name="link{number}"><pose relative_to="j{number}">0 0 0 0 0 0</pose>'
        yield f"<inertial><pose>{link.com} 0 0 0</pose><mass>{link.mass}</mass>"
        yield f"<inertia>{entries}</inertia></inertial></link>"

    one = "<ixx>1</ixx><iyy>1</iyy><izz>1</izz><ixy>0</ixy><ixz>0</ixz><iyz>0</iyz>"
    base = f'<link name="link0"><inertial><mass>1</mass><inertia>{one}</inertia></inertial></link>'
    tie = '<joint name="tie" type="fixed"><parent>world</parent><child>link0</child></joint>'
    parts = [line for number, link in enumerate(list_links(tree), 1) for line in write(number, link)]
    return "\n".join([f'<sdf version="1.10"><model name="{tree.name}">', base, tie, *parts, "</model></sdf>"]) + "\n"


def _write_urdf(task: Task) -> Path:
    path = task.folder / "mechanism.urdf"
    path.write_text(write_urdf(task.tree), encoding="utf-8")
    return path


# --- measurement ---------------------------------------------------------------------------------------------------


def draw(tree: Tree, kernels: Mechanism, function: str, folder: Path) -> tuple[Task, Numbers]:
    """Draw states, and compute the kernel's results for them."""
    rng, n = np.random.default_rng(0), len(tree.bodies)
    q, qd, last = (rng.uniform(0.1, 0.6, (STATES, n)) for _ in range(3))
    actuated = [i for i, body in enumerate(tree.bodies) if body.joint.actuated]
    if function == "exp2":
        last[:, [i for i in range(n) if i not in actuated]] = 0.0
    given: dict[str, Any] = {"q": q, "qd": qd}
    if function == "impl":
        given |= {"qdd": last}
    given |= {"u": last[:, actuated] if function == "exp2" else np.zeros((STATES, len(actuated)))}
    taken = {a.name for a in kernels.describe(function).inputs if a.nnz}
    results = kernels(function, **{name: x for name, x in given.items() if name in taken})
    return Task(tree, function, q, qd, last, folder), next(iter(results.values()))


def measure(prepare: Prepare, task: Task, expected: Numbers) -> float:
    """Return the least processor time in ns a state. Raises ArithmeticError for other results than the kernel's."""
    run, states = prepare(task)
    found = run()
    if found is not None:
        wanted = expected[-1:] if len(found) == 1 else expected[: len(found)]
        gap = np.abs(found - wanted).max() / np.abs(wanted).max()
        if not gap < (1e-3 if prepare is prepare_mujoco else AGREE):
            raise ArithmeticError(f"results differ by {gap:.1e}")
    least = float("inf")
    for _ in range(CALLS):
        begin = time.process_time_ns()
        run()
        least = min(least, time.process_time_ns() - begin)
    return least / states


def main() -> None:
    """Measure one peer in one mechanism; print a time or a reason for each function."""
    name, model = sys.argv[1], Path(sys.argv[2])
    told: dict[str, float | str] = {}
    with TemporaryDirectory() as place:
        folder, tree = Path(place), read_tree(model)
        kernels = mbsrun.load(model, extent=Extent(FUNCTIONS, 0))
        for function in FUNCTIONS:
            try:
                told[function] = measure(PEERS[name], *draw(tree, kernels, function, folder))
            except Exception as fault:  # a peer may fail in any way, which the page states
                kind = "" if isinstance(fault, NotImplementedError) else f"{type(fault).__name__}: "
                told[function] = f"{kind}{fault}".splitlines()[0][:120]
    print(json.dumps(told))


if __name__ == "__main__":
    main()
