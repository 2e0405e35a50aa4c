"""Stand-ins for loaded kernels: CasADi functions, made by hand, behind the interface of loaded kernels."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbsgen.formulations import ports
from mbsgen.manifest import FORMAT, Argument, Coordinate, Flops, Frame, Kernel, Manifest
from mbsgen.roles import Role, split_kernel
from mbsgen.tape.ports import Port
from mbsrun.ocp.ground.plant import Unchangeable

_NAMES_OF_RESIDUAL = (["q", "qd", "qdd", "u"], ["Phi"])
FREE = {"lower": None, "upper": None}
_DERIVATIVES: Mapping[str, Callable[[ca.Function], ca.Function]] = {
    "jac_adj1_": lambda function: function.reverse(1).jacobian(),
    "adj1_": lambda function: function.reverse(1),
    "jac_": lambda function: function.jacobian(),
}
_NONE = Flops(paper=0, arithmetic=0, add=0, mul=0, div=0, neg=0, sqrt=0, trig=0, other=0)


class Peer(Unchangeable):
    """A manifest, calls by name, CasADi functions by name; `impl`, `sensors` and `frames` are given as SX functions."""

    def __init__(
        self,
        name: str,
        functions: Mapping[str, ca.Function],
        joints: Sequence[Coordinate],
        frames: Sequence[Frame],
        **loops: Any,
    ) -> None:
        self._functions = {**functions, "jac_impl": functions["impl"].jacobian()}
        self._batches: dict[tuple[str, int], _Batch] = {}
        self.manifest = Manifest(
            format=FORMAT,
            generator="by hand",
            model=name,
            prefix="peer",
            model_hash="0" * 64,
            header="",
            sources=(),
            coordinates=tuple(joints),
            parameters=(),
            frames=tuple(frames),
            kernels=tuple(_describe(name, function) for name, function in self._functions.items()),
            **loops,
        )

    def with_functions(self, functions: Mapping[str, ca.Function]) -> Peer:
        """Return the same with more functions."""
        known = {k: function for k, function in self._functions.items() if not k.startswith(tuple(_DERIVATIVES))}
        m = self.manifest
        return Peer(m.model, {**known, **functions}, m.coordinates, m.frames)

    def casadi(self, name: str, *, design: bool = False) -> ca.Function:
        """Return a kernel as a CasADi function; derivatives are CasADi's. It has no parameters."""
        assert not design, "a peer has no parameters"
        if name not in self._functions:
            for prefix, differentiate in _DERIVATIVES.items():
                if name.startswith(prefix):
                    self._functions[name] = differentiate(self.casadi(name.removeprefix(prefix)))
                    break
        return self._functions[name]

    def find_family(self, name: str) -> Peer:
        """Return the kernels that hold a function with all of its derivatives: these."""
        self.describe(name)
        return self

    def describe(self, name: str) -> Kernel:
        """Describe a kernel, with its patterns."""
        return _describe(name, self.casadi(name))

    def __call__(self, name: str, /, *, sparse: bool = False, **inputs: ArrayLike) -> dict[str, NDArray[np.float64]]:
        """Evaluate; a leading batch axis on all inputs is allowed."""
        first = next(key for key in self.casadi(name).name_in() if not key.startswith("out_"))
        is_batch = np.ndim(inputs[first]) == 2  # the first input is a vector
        states = len(np.asarray(inputs[first])) if is_batch else 1
        if (name, states) not in self._batches:
            self._batches[name, states] = _Batch(self.casadi(name), states)
        found = self._batches[name, states](inputs, sparse=sparse)
        return found if is_batch else {key: value[0] for key, value in found.items()}


class _Batch:
    """A function at several states at once, on its own buffers."""

    def __init__(self, function: ca.Function, states: int) -> None:
        self._states = states
        self._buffer, self._run = function.map(states).buffer()
        self._inputs, self._outputs = {}, {}
        for i, name in enumerate(function.name_in()):
            if not name.startswith("out_"):
                held, pattern = np.zeros((states, function.nnz_in(i))), function.sparsity_in(i)
                rows, cols = (np.array(k, dtype=int) for k in pattern.get_triplet())
                self._inputs[name] = held, pattern.shape, rows, cols
                if held.size:
                    self._buffer.set_arg(i, held.data)  # type: ignore[call-arg]
        for i, name in enumerate(function.name_out()):
            values, pattern = np.zeros((states, function.nnz_out(i))), function.sparsity_out(i)
            rows, cols = (np.array(k, dtype=int) for k in pattern.get_triplet())
            self._outputs[name] = values, pattern.shape, rows, cols
            if values.size:
                self._buffer.set_res(i, values.data)  # type: ignore[call-arg]

    def __call__(self, inputs: Mapping[str, ArrayLike], *, sparse: bool) -> dict[str, NDArray[np.float64]]:
        assert set(inputs) == set(self._inputs), f"it takes {list(self._inputs)}"
        for name, (held, shape, rows, cols) in self._inputs.items():
            held[:] = np.asarray(inputs[name], dtype=float).reshape(self._states, *shape)[:, rows, cols]
        self._run()
        assert not self._buffer.ret(), "it can be evaluated"
        found = {}
        for name, (values, shape, rows, cols) in self._outputs.items():
            if sparse:
                found[name] = values.copy()
                continue
            whole = np.zeros((self._states, *shape))
            whole[:, rows, cols] = values
            found[name] = whole[:, :, 0] if shape[1] == 1 and not name.startswith("jac_") else whole
        return found


def pose_functions(q: ca.SX, sensors: ca.SX, p: ca.SX, R: ca.SX) -> dict[str, ca.Function]:
    """Make the functions of positions, and the velocities of sensors."""
    qd = ca.SX.sym("qd", q.numel())
    v = ca.reshape(ca.jacobian(sensors, q) @ qd, *sensors.shape)
    return {
        "sensors": ca.Function("peer_sensors", [q], [sensors], ["q"], ["position"], {"cse": True}),
        "motion": ca.Function("peer_motion", [q, qd], [v], ["q", "qd"], ["v"], {"cse": True}),
        "frames": ca.Function("peer_frames", [q], [p, R], ["q"], ["p", "R"], {"cse": True}),
    }


def residual_function(q: ca.SX, qd: ca.SX, qdd: ca.SX, u: ca.SX, Phi: ca.SX) -> ca.Function:
    """Make the function of the equations of motion."""
    return ca.Function("peer_impl", [q, qd, qdd, u], [Phi], *_NAMES_OF_RESIDUAL, {"cse": True})


def explicit_functions(residual: ca.Function) -> dict[str, ca.Function]:
    """Solve the equations of motion for the accelerations: M(q) qdd = -Phi(q, qd, 0, u), M being dPhi/dqdd."""
    q, qd, qdd, u = residual.sx_in()
    M = ca.jacobian(residual(q, qd, qdd, u), qdd)
    accelerations = ca.solve(M, -residual(q, qd, 0, u))
    return {
        "semi_res": ca.Function("peer_semi_res", [q, qd, qdd, u], [residual(q, qd, qdd, u)], *_NAMES_OF_RESIDUAL),
        **{
            k: ca.Function(f"peer_{k}", [q, qd, u], [accelerations], ["q", "qd", "u"], ["qdd"], {"cse": True})
            for k in ("exp1", "exp2")
        },
    }


def double_integrator() -> Peer:
    """A mass of 1 kg that is pushed along x: qdd = u; its place is a sensor."""
    q, qd, qdd, u = (ca.SX.sym(name) for name in ("q", "qd", "qdd", "u"))
    p = ca.vertcat(q, 0, 0)
    residual = residual_function(q, qd, qdd, u, qdd - u)
    return Peer(
        "double integrator",
        {
            "impl": residual,
            **explicit_functions(residual),
            **pose_functions(q, p, ca.horzcat(p, p), ca.horzcat(ca.SX.eye(3), ca.SX.eye(3))),
        },
        [Coordinate(name="slide", motion="prismatic", actuated=True, **FREE)],
        [Frame(name="cart", parent=-1, sensor=False), Frame(name="place", parent=0, sensor=True)],
    )


_ROLES = {
    port.name: port.role for port in vars(ports).values() if isinstance(port, Port) and port.role is not Role.RESULT
}


def _describe(name: str, function: ca.Function) -> Kernel:
    base, order = split_kernel(name)
    return Kernel(
        name=name,
        base=base,
        order=order,
        symbol=function.name(),
        function=function.name(),
        sources=(),
        inputs=tuple(_argument(function.name_in(i), function.sparsity_in(i)) for i in range(function.n_in())),
        outputs=tuple(_argument(function.name_out(i), function.sparsity_out(i)) for i in range(function.n_out())),
        flops=_NONE,
        equations=0,
    )


def _argument(name: str, pattern: ca.Sparsity) -> Argument:
    (rows, cols), role = pattern.shape, _ROLES.get(name, Role.RESULT)
    if pattern.is_dense():
        return Argument(name=name, role=role, rows=rows, cols=cols)
    return Argument(
        name=name, role=role, rows=rows, cols=cols, colind=tuple(pattern.colind()), row=tuple(pattern.row())
    )
