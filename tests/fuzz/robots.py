"""Draws robots in URDF and SDF, and compares our readers with Pinocchio's and Drake's.

Pinocchio reads the robots in URDF whose joints have one freedom: Phi, M, c and qdd agree. Drake reads all: poses of
links, kinetic and potential energy, and the power of damping and springs agree at random states. These decide the
equations of motion by Lagrange. Joints of several freedoms have other coordinates in Drake, which this module computes.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mbsgen.errors import MbsError
from mbsgen.expressions import FLOATS
from mbsgen.expressions import evaluate as evaluate_number
from mbsgen.formulations.catalogue import FUNCTIONS
from mbsgen.formulations.reductions import NONE
from mbsgen.importing import Choices, Imported, import_model
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.following import list_joints
from mbsgen.tape.interpreter import evaluate
from tests import peers
from tests.fuzz.mechanisms import Tally
from tests.fuzz.robot_drawing import Robot, draw
from tests.import_peers import Kernels, PinocchioPeer, largest_miss, strip_forces

Array = NDArray[np.float64]
ROUNDING = 1e-9  # of the largest entry: products of some ten rotations, whose angles the files have to all digits
STATES = 2
GRAVITY = (0.3, -0.4, -9.0)


def has_drake() -> bool:
    """Return whether Drake is installed, or among the peers."""
    if peers.FOLDER.exists() and str(peers.FOLDER) not in sys.path:
        sys.path.append(str(peers.FOLDER))
    try:
        import pydrake  # noqa: F401
    except ImportError:
        return False
    return True


@dataclass(frozen=True)
class Motion:
    """Numbers that decide the equations of motion, at one state."""

    poses: dict[str, Array]  # of links in the base, 3 by 4
    kinetic: float
    potential: float
    power: float  # of damping

    def find_miss(self, other: Motion, start: Motion, other_start: Motion) -> str:
        """Return the first difference from another program's motion; energies count from a start."""
        for name, pose in self.poses.items():
            if name in other.poses and (miss := np.abs(pose - other.poses[name]).max()) > ROUNDING:
                return f"the pose of {name} differs by {miss:.2g}"
        own, theirs = self.potential - start.potential, other.potential - other_start.potential
        for what, a, b in (
            ("kinetic energy", self.kinetic, other.kinetic),
            ("potential energy", own, theirs),
            ("power", self.power, other.power),
        ):
            if abs(a - b) > ROUNDING * max(1, abs(a), abs(b)):
                return f"{what} is {a:.9g}, and {b:.9g} in Drake"
        return ""


class Ours:
    """A robot as our reader reads it."""

    def __init__(self, imported: Imported) -> None:
        self.tree = build_tree(imported.model)
        self.links = [frame.name for frame in imported.model.frames]
        self.names = [*self.tree.coordinates]
        self._frames, self._energy = (FUNCTIONS[name].build(self.tree, NONE) for name in ("frames", "energy"))
        bare = build_tree(strip_forces(imported.model))
        self._residuals = [FUNCTIONS["impl"].build(tree, NONE) for tree in (self.tree, bare)]

    def place(self, q: Array) -> dict[str, Array]:
        """Compute the poses of all links."""
        found = evaluate(self._frames, {"q": list(q)})
        first = len(found["p"]) // 3 - len(self.links)
        p, R = np.array(found["p"], float).reshape(-1, 3), np.array(found["R"], float).reshape(-1, 3, 3)
        return {
            name: np.column_stack([R[first + k].T, p[first + k]])  # frames stand behind the bodies
            for k, name in enumerate(self.links)
        }

    def drift(self, q: Array, qd: Array) -> dict[str, Array]:
        """Differentiate the poses of all links by time: differences of fourth order, whose errors are below 1e-11."""
        near, far = ([self.place(q + side * h * qd) for side in (1, -1)] for h in (5e-4, 1e-3))
        return {
            name: (8 * (near[0][name] - near[1][name]) - (far[0][name] - far[1][name])) / (12 * 5e-4)
            for name in near[0]
        }

    def move(self, q: Array, qd: Array) -> Motion:
        """Compute the motion at a state."""
        poses = self.place(q)
        energy = evaluate(self._energy, {"q": list(q), "qd": list(qd)})
        return Motion(poses, float(energy["kinetic"][0]), float(energy["potential"][0]), -self._resist(q, qd) @ qd)

    def _resist(self, q: Array, qd: Array) -> Array:
        both = []
        for tape in self._residuals:
            given = {"q": q, "qd": qd}
            values = {i.name: list(given.get(i.name, np.zeros(i.sparsity.nnz))) for i in tape.inputs}
            both.append(np.array(evaluate(tape, values)["Phi"], float))
        return both[0] - both[1]


class Drake:
    """A robot as Drake's parser reads it."""

    def __init__(self, robot: Robot, path: Path, gravity: Array, axes: dict[str, Array]) -> None:
        from pydrake.multibody.parsing import Parser
        from pydrake.multibody.plant import MultibodyPlant

        plant = self.plant = MultibodyPlant(0.0)
        Parser(plant).AddModels(str(path))
        plant.mutable_gravity_field().set_gravity_vector(gravity)
        if robot.root is not None:
            plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(robot.root))
        plant.Finalize()
        self.gravity, self.axes = gravity, axes
        self.links = {name: self._find(name) for name in robot.links}
        self.context = plant.CreateDefaultContext()

    def _find(self, name: str) -> Any:
        """Return the body of a link, by the path of models to it."""
        *models, link = name.split("::")
        if self.plant.HasModelInstanceNamed("machine") and not models:
            return self.plant.GetBodyByName(link, self.plant.GetModelInstanceByName("machine"))
        return self.plant.GetBodyByName(link, self.plant.GetModelInstanceByName("::".join(["machine", *models])))

    def _place(self, name: str) -> Array:
        return np.array(self.plant.EvalBodyPoseInWorld(self.context, self.links[name]).GetAsMatrix34())

    def move(self, own: dict[str, tuple[float, float]], links: dict[str, tuple[Array, Array]] | None = None) -> Motion:
        """Compute the motion at a state, given coordinates and velocities by our names, and poses and rates of links.

        None: in the pose of the file.
        """
        from pydrake.multibody.tree import MultibodyForces

        names = {body.index(): name for name, body in self.links.items()}
        for index in () if links is None else self.plant.GetJointIndices():
            joint = self.plant.get_joint(index)
            link = names[joint.child_body().index()] if joint.num_velocities() else ""
            if links and joint.type_name() == "quaternion_floating":
                self._float(link, *links[link])
            elif link:
                self._set(joint, link, own)
        poses = {name: self._place(name) for name in self.links}
        forces = MultibodyForces(self.plant)
        self.plant.CalcForceElementsContribution(self.context, forces)  # gravity acts on bodies, all else on joints
        power = float(np.dot(forces.generalized_forces(), self.plant.GetVelocities(self.context)))
        moment = self.plant.CalcTotalMass(self.context) * self.plant.CalcCenterOfMassPositionInWorld(self.context)
        return Motion(poses, self.plant.CalcKineticEnergy(self.context), -float(np.dot(self.gravity, moment)), power)

    def _float(self, link: str, pose: Array, rate: Array) -> None:
        """Place a free body, which may be another link than our free one."""
        from pydrake.math import RigidTransform
        from pydrake.multibody.math import SpatialVelocity

        spin = rate[:, :3] @ pose[:, :3].T
        omega = np.array([spin[2, 1] - spin[1, 2], spin[0, 2] - spin[2, 0], spin[1, 0] - spin[0, 1]]) / 2
        self.plant.SetFreeBodyPose(self.context, self.links[link], RigidTransform(pose))
        self.plant.SetFreeBodySpatialVelocity(self.context, self.links[link], SpatialVelocity(omega, rate[:, 3]))

    def _set(self, joint: Any, link: str, own: dict[str, tuple[float, float]]) -> None:
        """Set the pose and the velocity of a joint of Drake from our joint."""
        from pydrake.math import RollPitchYaw

        context = self.context
        match joint.type_name():
            case "ball_rpy":
                rotation, omega = self._turn_ball(joint, link, own)
                joint.set_angles(context, RollPitchYaw(rotation_matrix(rotation)).vector())
                joint.set_angular_velocity(context, omega)
            case "planar":
                names = [name for name in own if name.rpartition(".")[0] == link]  # two slides, and a turn
                (x, vx), (y, vy), (a, om) = (own[name] for name in names)
                one, other, normal = (self.axes[name] for name in names)
                R = shortest_way(normal)
                joint.set_translation(context, (R.T @ (x * one + y * other))[:2])
                joint.set_rotation(context, a)
                joint.set_translational_velocity(context, (R.T @ (vx * one + vy * other))[:2])
                joint.set_angular_velocity(context, om)
            case "universal":
                (a, va), (b, vb) = (
                    find(own, f"{joint.name()}.{axis}") or own[f"{link}.r{letter}"]
                    for axis, letter in (("axis", "x"), ("axis2", "y"))
                )
                joint.set_angles(context, [a, b])
                joint.set_angular_rates(context, [va, vb])
            case _:
                q, v = find(own, joint.name()) or (0.0, 0.0)
                self.plant.SetPositions(context, self._put(self.plant.GetPositions(context), joint.position_start(), q))
                self.plant.SetVelocities(
                    context, self._put(self.plant.GetVelocities(context), joint.velocity_start(), v)
                )

    def _turn_ball(self, joint: Any, link: str, own: dict[str, tuple[float, float]]) -> tuple[Array, Array]:
        """Return the turn of a ball's child in its parent; ours may be the parent's turn in the child."""
        if f"{link}.rz" in own:
            return turn(own, link)
        names = {body.index(): name for name, body in self.links.items()}
        rotation, omega = turn(own, names[joint.parent_body().index()])
        return rotation.T, -rotation.T @ omega

    @staticmethod
    def _put(values: Array, k: int, value: float) -> Array:
        changed = np.array(values)
        changed[k] = value
        return changed


def find(own: dict[str, tuple[float, float]], name: str) -> tuple[float, float] | None:
    """Return the coordinate and the velocity of a joint of some model."""
    return next((value for key, value in own.items() if key.split("::")[-1] == name), None)


def list_axes(imported: Imported) -> dict[str, Array]:
    """Return the directions of all joints of a model, of length 1."""
    found = {}
    for step in list_joints(imported.model):
        axis = np.array([evaluate_number(component, {}, FLOATS) for component in step.joint.axis], float)
        found[step.name] = axis / np.linalg.norm(axis)
    return found


def shortest_way(direction: Array) -> Array:
    """Return the rotation about an axis across both that turns the z axis to a direction."""
    across = np.cross([0, 0, 1.0], direction)
    angle = np.arctan2(np.linalg.norm(across), direction[2])
    if not across.any():
        across = np.array([1.0, 0, 0])
    return np.array(Rotation.from_rotvec(angle * across / np.linalg.norm(across)).as_matrix())


def rotation_matrix(matrix: Array) -> Any:
    from pydrake.math import RotationMatrix

    return RotationMatrix(matrix)


def turn(own: dict[str, tuple[float, float]], link: str) -> tuple[Array, Array]:
    """Return the rotation by turns about z, y, x, and the angular velocity in the frame before them."""
    R, omega = np.eye(3), np.zeros(3)
    for axis, name in ((2, "rz"), (1, "ry"), (0, "rx")):
        q, qd = own[f"{link}.{name}"]
        omega = omega + R[:, axis] * qd
        s, c = np.sin(q), np.cos(q)
        one, other = (axis + 1) % 3, (axis + 2) % 3
        T = np.eye(3)
        T[one, one], T[other, other], T[one, other], T[other, one] = c, c, -s, s
        R = R @ T
    return R, omega


def examine(robot: Robot, seed: int, *, drake: bool) -> str:
    """Return the first difference between our reading of a robot and the others'. Raises MbsError if we refuse it."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"machine.{robot.suffix}"
        path.write_text(robot.text, encoding="utf-8")
        imported = import_model(path, Choices(gravity=GRAVITY, sensors=robot.links, quarter_turns=0))
        finding = _compare_with_pinocchio(path) if robot.is_plain else ""
        return finding or (_compare_with_drake(robot, path, imported, seed) if drake else "")


def _compare_with_pinocchio(path: Path) -> str:
    kernels = Kernels(import_model(path, Choices(quarter_turns=0)), ("impl", "semi", "exp2"))
    peer = PinocchioPeer(path, kernels.joints, floating=False)
    for state in kernels.draw_states():
        for name, miss in largest_miss(kernels.compute(state), peer.compute(state)).items():
            if miss > ROUNDING:
                return f"{name} differs from Pinocchio's by {miss:.2g}"
    return ""


def _compare_with_drake(robot: Robot, path: Path, imported: Imported, seed: int) -> str:
    try:
        theirs = Drake(robot, path, np.array(GRAVITY), list_axes(imported))
    except RuntimeError as error:
        if "reversed" in str(error):  # Drake cannot carry the parent of such a joint
            return ""
        raise
    ours = Ours(imported)
    rng, count = np.random.default_rng(seed), len(ours.names)
    start, other_start = ours.move(np.zeros(count), np.zeros(count)), theirs.move({})
    if imported.model.loops:  # Drake reverses joints where we close loops: coordinates differ, poses of the file do not
        return start.find_miss(other_start, start, other_start)
    for _ in range(STATES):
        q, qd = rng.uniform(-1.2, 1.2, (2, count))
        at = {name: (float(a), float(b)) for name, a, b in zip(ours.names, q, qd, strict=True)}
        poses, rates = ours.place(q), ours.drift(q, qd)
        links = {name: (poses[name], rates[name]) for name in poses}
        if finding := ours.move(q, qd).find_miss(theirs.move(at, links), start, other_start):
            return finding
    return ""


def search(
    count: int, seed: int, keep: Path | None = None, show: Callable[[int, Tally], None] = lambda *_: None
) -> Tally:
    """Examine robots from a seed on."""
    tally, drake = Tally(), has_drake()
    for number in range(seed, seed + count):
        robot = draw(number)
        try:
            finding = examine(robot, number, drake=drake)
        except MbsError as error:
            tally.refused.append((number, str(error).splitlines()[0]))
        except Exception as error:
            finding = f"{type(error).__name__}: {error}"
        if tally.refused and tally.refused[-1][0] == number:
            pass
        elif finding:
            tally.findings.append((number, finding))
            if keep is not None:
                keep.mkdir(parents=True, exist_ok=True)
                (keep / f"robot_{number}.{robot.suffix}").write_text(
                    f"<!-- {finding} -->\n{robot.text}", encoding="utf-8"
                )
        else:
            tally.agreed += 1
        show(number, tally)
    return tally
