"""Imported models against Pinocchio's and MuJoCo's of the same files: Phi, M, c, qdd, and first derivatives.

Joints' own forces are removed from both sides, as Pinocchio's recursions have none. Rotors count, except rotors of
balls and free bodies, which a model does not have. Where a body turns freely, MuJoCo's velocities v are T(q) qd; this
transforms its equations to our coordinates.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mbsgen.importing import Imported
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.model import FREE, Body, Fixed, Joint, Model
from mbsgen.pipeline import write_families
from mbsgen.request import Request
from mbsgen.tape.interpreter import evaluate
from mbsgen.tape.types import Input, Sparsity

Array = NDArray[np.float64]
STATES = 3
SMALL = 1e-3  # what is smaller may be the rounding of a 0


@dataclass(frozen=True)
class State:
    """Coordinates, velocities, accelerations and forces of all joints, in our order."""

    q: Array
    qd: Array
    qdd: Array
    Q: Array


def strip_forces(model: Model) -> Model:
    """Take the joints' own forces away, and let each have an input."""

    def bare(joint: Joint) -> Joint:
        return replace(joint, law=FREE, actuated=True)

    def strip(body: Body) -> Body:
        if isinstance(body.joint, Fixed):
            return body
        return replace(body, joint=bare(body.joint) if isinstance(body.joint, Joint) else tuple(map(bare, body.joint)))

    return replace(model, bodies=tuple(map(strip, model.bodies)))


class Kernels:
    """The kernels of an imported model, evaluated in float64."""

    def __init__(self, imported: Imported, functions: tuple[str, ...], *, derivatives: int = 0) -> None:
        self.tree = build_tree(strip_forces(imported.model))
        self.joints = [body.joint.name for body in self.tree.bodies]
        families = write_families(self.tree, Request(functions=functions, derivatives=derivatives))
        self._wanted = [*functions, *(f"jac_{name}" for name in functions if derivatives and name != "semi")]
        self._tapes = {tape.name: tape for family in families for tape in family.tapes}

    def draw_states(self, seed: int = 0) -> list[State]:
        """Draw random states, away from where three turns lock."""
        rng = np.random.default_rng(seed)
        n = len(self.joints)
        return [State(*rng.uniform(-1.2, 1.2, (4, n))) for _ in range(STATES)]

    def compute(self, state: State) -> dict[str, Array]:
        """Compute all results; matrices are full."""
        return {key: value for name in self._wanted for key, value in self._evaluate(name, state).items()}

    def _evaluate(self, name: str, state: State) -> dict[str, Array]:
        tape = self._tapes[name]
        given = {"q": state.q, "qd": state.qd, "qdd": state.qdd, "u": state.Q}
        values = evaluate(tape, {i.name: _take(i, given) for i in tape.inputs})
        return {o.name: _fill(o.sparsity, values[o.name]) for o in tape.outputs}


def _take(wanted: Input, given: Mapping[str, Array]) -> list[float]:
    """Return an input; a Jacobian may need a result of its function, although its values do not depend on it."""
    return list(given.get(wanted.name, np.zeros(wanted.sparsity.nnz)))


def _fill(sparsity: Sparsity, values: list[float]) -> Array:
    matrix = np.zeros((sparsity.rows, sparsity.cols))
    for (row, col), value in zip(sparsity.entries, values, strict=True):
        matrix[row, col] = value
    return matrix[:, 0] if sparsity.cols == 1 else matrix


class PinocchioPeer:
    """A URDF file as Pinocchio reads it; a free base slides along x, y, z and turns about z, y, x, as ours does."""

    def __init__(
        self,
        path: Path,
        joints: list[str],
        *,
        floating: bool,
        locked: Mapping[str, float] = {},
        rotors: Mapping[str, float] = {},  # armatures, of which Pinocchio's reader knows nothing
    ) -> None:
        model = pin.buildModelFromUrdf(str(path))
        if floating:
            model = _free(model)
        if locked:
            at = pin.neutral(model)
            for name, value in locked.items():
                at[model.idx_qs[model.getJointId(name)]] = value
            model = pin.buildReducedModel(model, [model.getJointId(name) for name in locked], at)
        self.model = model
        for name, armature in rotors.items():
            model.armature[self._find(name)] = armature
        self.data = model.createData()
        self._order = np.array([*range(6)] * floating + [self._find(name) for name in joints[6 * floating :]])

    def _find(self, name: str) -> int:
        return int(self.model.idx_vs[self.model.getJointId(name)])

    def _scatter(self, values: Array) -> Array:
        out = np.zeros(self.model.nv)
        out[self._order] = values
        return out

    def _gather(self, values: Array) -> Array:
        return values[np.ix_(*[self._order] * values.ndim)]

    def _configure(self, q: Array) -> Array:
        """Make Pinocchio's configuration: of a joint without limits, cosine and sine."""
        return np.asarray(pin.integrate(self.model, pin.neutral(self.model), self._scatter(q)))

    def compute(self, state: State) -> dict[str, Array]:
        """Compute Phi, M, c, qdd and their derivatives by q, in our order."""
        q, v = self._configure(state.q), self._scatter(state.qd)
        a, Q = self._scatter(state.qdd), self._scatter(state.Q)
        upper = np.triu(pin.crba(self.model, self.data, q))
        residual = [np.array(x) for x in pin.computeRNEADerivatives(self.model, self.data, q, v, a)]  # not views
        explicit = [np.array(x) for x in pin.computeABADerivatives(self.model, self.data, q, v, Q)]
        found = {
            "Phi": pin.rnea(self.model, self.data, q, v, a) - Q,
            "M": upper + np.triu(upper, 1).T,
            "c": pin.rnea(self.model, self.data, q, v, np.zeros(self.model.nv)),
            "qdd": pin.aba(self.model, self.data, q, v, Q),
            **dict(zip(("jac_Phi_q", "jac_Phi_qd"), residual, strict=False)),
            **dict(zip(("jac_qdd_q", "jac_qdd_qd"), explicit, strict=False)),
        }
        return {name: self._gather(np.array(value)) for name, value in found.items()}


def _free(model: Any) -> Any:
    """Slide a model along x, y, z and turn it about z, y, x as a whole."""
    base = pin.Model()
    base.gravity = model.gravity
    last = 0
    for one in ("PX", "PY", "PZ", "RZ", "RY", "RX"):
        last = base.addJoint(last, getattr(pin, f"JointModel{one}")(), pin.SE3.Identity(), f"free {one}")
    frame = base.addFrame(pin.Frame("free", last, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    whole = pin.appendModel(base, model, frame, pin.SE3.Identity())
    return whole[0] if isinstance(whole, tuple) else whole


class MujocoPeer:
    """An MJCF file as MuJoCo reads it, without joints' own forces; joints stand in our order."""

    def __init__(self, path: Path) -> None:
        import mujoco

        self._mujoco = mujoco
        self.model = mujoco.MjModel.from_xml_path(str(path))
        loose = np.isin(self.model.jnt_type[self.model.dof_jntid], (0, 1))  # free bodies and balls
        self.model.dof_armature[loose] = 0
        self.data = mujoco.MjData(self.model)

    def compute(self, state: State) -> dict[str, Array]:
        """Compute Phi, M, c and qdd, in our coordinates."""
        T, slope = self._rates(state.q), self._rates_along(state.q, state.qd)
        M, c = self._equations(state.q, T @ state.qd)
        mass, bias = T.T @ M @ T, T.T @ (M @ slope @ state.qd + c)
        return {
            "Phi": mass @ state.qdd + bias - state.Q,
            "M": mass,
            "c": bias,
            "qdd": np.linalg.solve(mass, state.Q - bias),
        }

    def _equations(self, q: Array, v: Array) -> tuple[Array, Array]:
        self._place(q)
        self.data.qvel[:] = v
        self._mujoco.mj_forward(self.model, self.data)
        n = self.model.nv
        c, M = np.zeros(n), np.zeros((n, n))
        self._mujoco.mj_rne(self.model, self.data, 0, c)
        columns = np.eye(n)
        for k in range(n):  # M by its columns: M e_k = Phi(e_k) - c, of velocities 0
            self._mujoco.mj_mulM(self.model, self.data, M[k], columns[k])
        return M, c

    def _place(self, q: Array) -> None:
        for j, kind in enumerate(self.model.jnt_type):
            i, k = self.model.jnt_qposadr[j], self.model.jnt_dofadr[j]
            match int(kind):
                case 0:
                    self.data.qpos[i : i + 3] = q[k : k + 3]
                    self.data.qpos[i + 3 : i + 7] = _quaternion(q[k + 3 : k + 6])
                case 1:
                    self.data.qpos[i : i + 4] = _quaternion(q[k : k + 3])
                case _:
                    self.data.qpos[i] = q[k]

    def _rates(self, q: Array) -> Any:
        """Make T(q): of three turns, the angular velocity in the frame that they turn."""
        T = np.eye(len(q), dtype=q.dtype)
        for j, kind in enumerate(self.model.jnt_type):
            if kind in (0, 1):
                k = self.model.jnt_dofadr[j] + (3 if kind == 0 else 0)
                T[k : k + 3, k : k + 3] = turn_rates(q[k], q[k + 1], q[k + 2])
        return T

    def _rates_along(self, q: Array, qd: Array) -> Array:
        """Differentiate T along qd, by a complex step."""
        return np.asarray(self._rates(q + 1e-200j * qd).imag / 1e-200)


def turn_rates(_: Any, y: Any, x: Any) -> Any:
    """Return the axes z, y, x of turns in that order as columns, seen from the last frame."""
    sx, cx, sy, cy = np.sin(x), np.cos(x), np.sin(y), np.cos(y)
    return np.array([[-sy, 0, 1], [cy * sx, cx, 0], [cy * cx, -sx, 0]])


def _quaternion(angles: Array) -> Array:
    z, y, x = (
        pin.Quaternion(pin.AngleAxis(a, np.eye(3)[k]).toRotationMatrix())
        for k, a in zip((2, 1, 0), angles, strict=True)
    )
    found = (z * y * x).coeffs()
    return np.array([found[3], *found[:3]])


def largest_miss(found: Mapping[str, Array], expected: Mapping[str, Array]) -> dict[str, float]:
    """Tell, for each result, the largest difference, relative to the largest entry, or to SMALL."""
    return {
        name: float(np.abs(found[name] - expected[name]).max() / max(SMALL, np.abs(expected[name]).max()))
        for name in found.keys() & expected.keys()
    }
