"""Variational steps in C: a model and its kernels laid out for `csrc/mbs_variational.c`.

The functions there take inputs over time alone, and no driven joint.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsgen.roles import Order, name_derivative, name_kernel
from mbsrun.closure import GAP
from mbsrun.simulation.drive import Piece
from mbsrun.simulation.dynamics import Dynamics
from mbsrun.simulation.integration.groups import Group
from mbsrun.simulation.memory import Memory, load_functions

Array = NDArray[np.float64]

_CDEF = """
typedef int (*mbs_kernel)(const double **arg, double **res, long long *iw, double *w, int mem);
typedef struct { mbs_kernel f; const double **arg; double **res; } mbs_call;
typedef struct { const double *nonzeros; long long entries; const long long *place; } mbs_entries;
typedef struct { long long first, spin, is_free; } mbs_attitude;
typedef struct {
    long long n, nq, m, e;
    double *q, *qd, *qdd, *v;
    const double *Phi, *gap;
    mbs_entries K, C, M, J, N;
    mbs_call dynamics, closure, jacobian, change;
    long long attitudes, scalars;
    const mbs_attitude *attitude;
    const long long *place, *rate;
} mbs_variational;
typedef struct { double converged, noise; long long most; } mbs_variational_end;
long long mbs_variational_reals(const mbs_variational *plant);
long long mbs_variational_integers(const mbs_variational *plant);
long long mbs_variational_run(const mbs_variational *plant, mbs_variational_end end, double h, long long steps,
                              const double *inputs, long long v_step, double *states, double *speeds, double *guess,
                              long long *iterations, double *reals, long long *integers);
"""


def is_taken(dynamics: Dynamics, piece: Piece) -> bool:
    """Return whether the functions in C take a model and its inputs."""
    return not dynamics.kernels.manifest.driven and piece.law is None


class Stepper:
    """A model as the C functions take it, with the memory that they use."""

    def __init__(self, dynamics: Dynamics, group: Group, end: tuple[float, float, int]) -> None:
        """Take a model, its group, and when an iteration ends: see `mbs_variational_end`."""
        self.dynamics, self.group = dynamics, group
        self.ffi, self.lib = load_functions(_CDEF, "mbs_variational.c", "mbs_dense.c")
        converged, noise, most = end
        self.end = (converged, noise if dynamics.kernels.manifest.owners else 0.0, most)
        self.plant = self.ffi.new("mbs_variational *")
        self._lay()
        self._lay_group()
        self.reals = np.empty(self.lib.mbs_variational_reals(self.plant) + 1)
        self.integers = np.empty(self.lib.mbs_variational_integers(self.plant) + 1, dtype=np.int64)

    def _lay(self) -> None:
        p, dynamics, manifest = self.plant, self.dynamics, self.dynamics.kernels.manifest
        n, nq, e = dynamics.size, dynamics.places, len(manifest.owners)
        p.n, p.nq, p.m, p.e = n, nq, len(manifest.inputs), e
        sizes = {"q": nq, "qd": n, "qdd": n, "lam": e, "v": p.m}
        memory = self.memory = Memory(self.ffi, dynamics.kernels, {x: np.zeros(k + 1) for x, k in sizes.items()})
        p.q, p.qd, p.qdd, p.v = (memory.pointer(name) for name in ("q", "qd", "qdd", "v"))
        name = name_kernel(dynamics.formulation.evaluated.function, Order.LINEARISATION)
        derivatives = {name_derivative("Phi", by): x for by, x in (("q", p.K), ("qd", p.C), ("qdd", p.M))}
        p.Phi = self._call(p.dynamics, name, {"Phi": None, **derivatives})["Phi"]
        if e:
            p.gap = self._call(p.closure, "loops", {GAP: None})[GAP]
            self._call(p.jacobian, "loop_jacobian", {"J": p.J})
        if manifest.configuration:
            self._call(p.change, "jac_rates", {"jac_rate_qd": p.N})

    def _call(self, call: Any, name: str, results: dict[str, Any]) -> dict[str, Any]:
        """Lay a kernel; return where its results are written. Matrices are described as entries; one may have none."""
        memory, laid, found = self.memory, {}, {}
        entry = memory.bind(name)
        for argument in entry.kernel.outputs:
            if argument.name in results and argument.nnz:
                laid[argument.name] = place = f"result {argument.name}"
                found[argument.name] = memory.add(place, argument.nnz + 1)
                if (entries := results[argument.name]) is not None:
                    entries.nonzeros = found[argument.name]
                    entries.entries, entries.place = argument.nnz, memory.place(entry, argument)
        call.f, call.arg, call.res = memory.lay(entry, laid)
        return found

    def _lay_group(self) -> None:
        p, memory, attitudes = self.plant, self.memory, self.group.attitudes
        rows = [(x.quaternion.first, x.quaternion.spin, int(x.is_free)) for x in attitudes]
        p.attitudes, p.attitude = len(rows), memory.keep(self.ffi.new("mbs_attitude[]", [*rows, (0, 0, 0)]))
        places, rates = self.group.scalars
        p.scalars, p.place, p.rate = len(places), memory.integers(places), memory.integers(rates)

    def run(self, h: float, inputs: Array, start: Array, guess: Array, steps: int) -> tuple[int, Array, Array]:
        """Take steps from a state (nq + n,); `guess` (n + e,) is the velocity and the multipliers, and is overwritten.

        Inputs (steps + 1, m), or one row for all. Return how many steps were taken, the states by rows with the start,
        and the velocities of the steps.
        """
        n = self.dynamics.size
        states, speeds = np.empty((steps + 1, len(start))), np.empty((steps, n))
        states[0] = start
        inputs, iterations = np.ascontiguousarray(inputs), self.ffi.new("long long *")
        done = self.lib.mbs_variational_run(
            self.plant,
            self.end,
            h,
            steps,
            self._point(inputs),
            inputs.shape[1] if len(inputs) > 1 else 0,
            *map(self._point, (states, speeds, guess)),
            iterations,
            self._point(self.reals),
            self.ffi.cast("long long *", self.integers.ctypes.data),
        )
        effort = self.dynamics.effort
        effort.iterations += iterations[0]
        effort.evaluations += 6 * iterations[0]
        effort.jacobians += 6 * iterations[0]
        return done, states[: done + 1], speeds[:done]

    def _point(self, array: Array) -> Any:
        return self.ffi.cast("double *", array.ctypes.data)
