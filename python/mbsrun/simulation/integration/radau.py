"""Steps of Radau collocation with closed loops in C: a model and its kernels laid out for `csrc/mbs_radau.c`.

The functions there take models without quaternions, and inputs over time alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsgen.roles import Order, name_derivative, name_kernel
from mbsrun.closure import GAP
from mbsrun.simulation.course import place_driven
from mbsrun.simulation.drive import Piece
from mbsrun.simulation.dynamics import Dynamics
from mbsrun.simulation.memory import Memory, load_functions

Array = NDArray[np.float64]

_RESULT = "result "  # begins the names of arrays that are no kernel's input
_CDEF = """
typedef int (*mbs_kernel)(const double **arg, double **res, long long *iw, double *w, int mem);
typedef struct { mbs_kernel f; const double **arg; double **res; } mbs_call;
typedef struct { const double *nonzeros; long long entries; const long long *place; } mbs_entries;
typedef struct {
    long long n, m, e, d, s;
    double *q, *qd, *qdd, *lam, *v;
    const double *Phi, *gap, *hd;
    mbs_entries K, C, M, L, G, R, J;
    mbs_call dynamics, closure, rates;
    const long long *driven;
    const double *A;
} mbs_radau;
typedef struct { double converged, noise; long long most; } mbs_radau_end;
long long mbs_radau_reals(const mbs_radau *plant);
long long mbs_radau_integers(const mbs_radau *plant);
long long mbs_radau_step(const mbs_radau *plant, mbs_radau_end end, double h, const double *inputs,
                         const double *courses, const double *q0, const double *v0, const double *weights, double *z,
                         double *q, double *v, double *reals, long long *integers);
"""


def is_taken(dynamics: Dynamics, piece: Piece) -> bool:
    """Return whether the functions in C take a model and its inputs."""
    return not dynamics.kernels.manifest.configuration and piece.law is None


class Stepper:
    """A model as the C functions take it, with the memory that they use."""

    def __init__(self, dynamics: Dynamics, A: Array, end: tuple[float, float, int]) -> None:
        """Take a model, the method's matrix (s, s), and when an iteration ends: see `mbs_radau_end`."""
        self.dynamics, self.manifest = dynamics, dynamics.kernels.manifest
        self.ffi, self.lib = load_functions(_CDEF, "mbs_radau.c", "mbs_dense.c")
        self.end, self.A = end, np.ascontiguousarray(A)
        self.plant = self.ffi.new("mbs_radau *")
        self._lay()
        self.reals = np.empty(self.lib.mbs_radau_reals(self.plant) + 1)
        self.integers = np.empty(self.lib.mbs_radau_integers(self.plant) + 1, dtype=np.int64)

    def _lay(self) -> None:
        p, dynamics, manifest = self.plant, self.dynamics, self.manifest
        n, e, d = dynamics.size, len(manifest.owners), len(manifest.driven)
        p.n, p.m, p.e, p.d, p.s = n, len(manifest.inputs), e, d, len(self.A)
        sizes = {"q": n, "qd": n, "qdd": n, "lam": e, "v": p.m, "tau": d}
        memory = self.memory = Memory(self.ffi, dynamics.kernels, {x: np.zeros(k + 1) for x, k in sizes.items()})
        p.q, p.qd, p.qdd, p.lam, p.v = (memory.pointer(name) for name in ("q", "qd", "qdd", "lam", "v"))
        name = name_kernel(dynamics.formulation.evaluated.function, Order.LINEARISATION)
        self._call(p.dynamics, name, "Phi", n, {"q": p.K, "qd": p.C, "qdd": p.M, "lam": p.L})
        p.Phi = memory.pointer(_RESULT + "Phi")
        if e:
            self._call(p.closure, name_kernel("loops", Order.LINEARISATION), GAP, e, {"q": p.G})
            self._call(p.rates, name_kernel("loop_rates", Order.LINEARISATION), "hd", e, {"q": p.R, "qd": p.J})
            p.gap, p.hd = memory.pointer(_RESULT + GAP), memory.pointer(_RESULT + "hd")
        assert place_driven(manifest) == list(manifest.driven), "coordinates stand where their velocities do"
        p.driven = memory.integers(manifest.driven)
        p.A = self._point(self.A)

    def _call(self, call: Any, name: str, result: str, size: int, derivatives: Mapping[str, Any]) -> None:
        """Lay a kernel with a result and its derivatives, of which some have no entry."""
        memory = self.memory
        entry = memory.bind(name)
        outputs = {argument.name: argument for argument in entry.kernel.outputs}
        memory.add(_RESULT + result, size + 1)
        laid = {result: _RESULT + result}
        for by, entries in derivatives.items():
            argument = outputs.get(name_derivative(result, by))
            if argument is None or not argument.nnz:
                continue
            laid[argument.name] = _RESULT + argument.name
            entries.nonzeros = memory.add(_RESULT + argument.name, argument.nnz + 1)
            entries.entries, entries.place = argument.nnz, memory.place(entry, argument)
        call.f, call.arg, call.res = memory.lay(entry, laid)

    def step(
        self, h: float, inputs: Array, courses: Array, start: tuple[Array, Array], weights: Array, z: Array
    ) -> tuple[Array, Array] | None:
        """Take a step from q and qd (n,): z (s, n + 2 e) is the guess of the unknowns, and becomes the solution.

        Inputs (s, m) and courses (s, 3 d) are of the stages. Return coordinates and velocities there, (s, n); None
        where the iteration fails.
        """
        q, qd = np.empty((len(z), self.dynamics.size)), np.empty((len(z), self.dynamics.size))
        arrays = [np.ascontiguousarray(x) for x in (inputs, courses, *start, weights)]
        count = self.lib.mbs_radau_step(
            self.plant,
            self.end,
            h,
            *map(self._point, (*arrays, z, q, qd, self.reals)),
            self.ffi.cast("long long *", self.integers.ctypes.data),
        )
        effort = self.dynamics.effort
        effort.iterations += count
        effort.evaluations += count * len(z)
        effort.jacobians += count * len(z)
        return (q, qd) if count else None

    def _point(self, array: Array) -> Any:
        return self.ffi.cast("double *", array.ctypes.data)
