"""Problems in stages: CasADi's functions for the solver in C, and the same problem as one program for IPOPT."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import casadi as ca
import cffi
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from mbsgen.resources import folder
from mbsrun.library import find_compiler

Array = NDArray[np.float64]
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror")
INFINITE = 1e20
IPOPT: dict[str, Any] = {
    "ipopt.print_level": 0,
    "print_time": False,
    "ipopt.sb": "yes",
    "ipopt.bound_relax_factor": 0.0,
}
STATUS = (
    "solved",
    "acceptable",
    "infeasible",
    "iteration limit",
    "time limit",
    "out of digits",
    "unbounded",
    "callback failed",
    "bad problem",
    "prepared",
    "stepped",
    "not prepared",
    "diverged",
)
QUADRATIC = """
typedef struct { const mbs_stages_size *size; const long *start; const REAL *data; } quadratic;
int quadratic_values(void *, int, const REAL *, const REAL *, REAL *, REAL *, REAL *, REAL *);
int quadratic_jacobians(void *, int, const REAL *, const REAL *, REAL *, REAL *, REAL *, REAL *);
int quadratic_hessian(void *, int, const REAL *, const REAL *, REAL, const REAL *, const REAL *, const REAL *, REAL *);
"""
Fault = Callable[[str, int, int], bool]  # function, which call of it, stage: whether it gives no numbers
FUNCTIONS = ("values", "jacobians", "hessian")
CANARY = b"\xa5" * 64


def sources() -> list[Path]:
    return sorted((folder("csrc") / "stages").glob("*.c"))


def compile_solver(place: Path, *flags: str) -> Path:
    """Compile the solver, and quadratic.c, to objects and a library; each object once for all workers of a run."""
    command = [*find_compiler(os.environ).command, *STRICT, "-O2", "-fPIC", *flags]
    headers = b"".join(path.read_bytes() for path in sorted(sources()[0].parent.glob("*.h")))
    for file in (*sources(), Path(__file__).parent / "quadratic.c"):
        name = hashlib.sha256(repr(command).encode() + headers + file.read_bytes()).hexdigest()
        made, kept = place / f"{file.stem}.o", Path(os.environ.get("MBS_TESTS_CACHE") or place) / f"{name}.o"
        if kept.exists():
            shutil.copyfile(kept, made)
            continue
        subprocess.run([*command, f"-I{sources()[0].parent}", "-c", str(file)], check=True, cwd=place)
        if kept.parent != place:
            copied = kept.with_name(f"{os.getpid()}-{kept.name}")
            shutil.copyfile(made, copied)
            copied.replace(kept)  # whole, or not there
    library = place / "libstages.so"
    objects = map(str, sorted(place.glob("*.o")))
    subprocess.run([*command, "-shared", *objects, "-lm", "-o", str(library)], check=True)
    return library


def declarations(real: str) -> str:
    """Return the declarations of the solver's header without what the preprocessor reads."""
    text = (sources()[0].parent / "mbs_stages.h").read_text("utf-8")
    text = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
    clashes = re.findall(r"#define MBS_STAGES_CLASHES (\d+)", text)[0]
    text = re.sub(r"#ifdef __cplusplus.*?#endif|#ifdef MBS_STAGES_FLOAT.*?#endif|#[^\n]*", "", text, flags=re.DOTALL)
    if real == "float":  # names in object files
        text = re.sub(r"\b(mbs_stages_[a-z_]+)\((?!\*)", r"\1_float(", text)
    return f"typedef {real} mbs_stages_real;" + text.replace("MBS_STAGES_CLASHES", clashes)


class Names:
    """Functions of a library in single precision, by their names in double precision."""

    def __init__(self, library: Any) -> None:
        self._library = library

    def __getattr__(self, name: str) -> Any:
        return getattr(self._library, f"{name}_float" if name.startswith("mbs_stages_") else name)


class Library:
    """The solver, loaded."""

    def __init__(self, path: Path, real: str = "double") -> None:
        self.ffi = cffi.FFI()
        self.ffi.cdef(declarations(real) + QUADRATIC.replace("REAL", real))
        loaded = self.ffi.dlopen(str(path))
        self.lib: Any = loaded if real == "double" else Names(loaded)
        self.real, self.dtype = real, np.dtype(np.float64 if real == "double" else np.float32)

    def numbers(self, a: Array) -> NDArray[Any]:
        return np.array(a, dtype=self.dtype)

    def pointer(self, a: NDArray[Any] | None) -> Any:
        return self.ffi.NULL if a is None else self.ffi.cast(f"{self.real} *", a.ctypes.data)

    def view(self, pointer: Any, n: int) -> NDArray[Any]:
        """The numbers in C's memory."""
        memory: Any = self.ffi.buffer(pointer, n * self.dtype.itemsize)
        return np.frombuffer(memory, self.dtype)


Pattern = tuple[list[int], list[int]]  # where columns begin, rows of nonzeros


@dataclass(frozen=True)
class Extra:
    """Inner variables of a stage, and the patterns of de, dd, dg and the lower triangle of the Hessian, if any."""

    inner: int = 0
    patterns: tuple[Pattern, ...] | None = None


def lay_sizes(library: Library, sizes: Sequence[tuple[int, ...]], extras: Sequence[Extra]) -> tuple[Any, list[Any]]:
    """Return sizes of stages in C, and what must live as long; stages with the same Extra share patterns."""
    ffi, kept, known = library.ffi, [], {}
    for extra in extras:
        if extra.patterns is not None and id(extra) not in known:
            arrays = [[ffi.new("int[]", part) for part in pattern] for pattern in extra.patterns]
            known[id(extra)] = ffi.new("mbs_stages_patterns *", arrays)
            kept += [arrays, known[id(extra)]]
    rows = [(*s, e.inner, known.get(id(e), ffi.NULL)) for s, e in zip(sizes, extras, strict=True)]
    return ffi.new("mbs_stages_size[]", [*rows, (0, 0, 0, 0, 0, ffi.NULL)]), kept


@dataclass(frozen=True)
class Kind:
    """A sort of stage: expressions of x and v, and bounds of (x, v) and of g."""

    x: ca.SX
    v: ca.SX
    cost: ca.SX
    d: ca.SX = field(default_factory=lambda: ca.SX(0, 1))
    e: ca.SX = field(default_factory=lambda: ca.SX(0, 1))
    g: ca.SX = field(default_factory=lambda: ca.SX(0, 1))
    inner: int = 0
    sparse: bool = False

    @cached_property
    def extra(self) -> Extra:
        _, jacobians, hessian = self.functions
        parts = [jacobians.sparsity_out(i) for i in (1, 2, 3)] + [hessian.sparsity_out(0)]
        patterns = tuple((list(p.colind()), list(p.row())) for p in parts)
        return Extra(self.inner, patterns if self.sparse else None)

    @property
    def size(self) -> tuple[int, int, int, int]:
        return self.x.numel(), self.v.numel(), self.e.numel(), self.g.numel()

    @cached_property
    def functions(self) -> tuple[ca.Function, ca.Function, ca.Function]:
        w = ca.vertcat(self.x, self.v)
        values = [self.cost, self.e, self.d, self.g]
        factor, *y = ca.SX.sym("factor"), *(ca.SX.sym(n, f.numel()) for n, f in zip("edg", values[1:], strict=True))
        lagrangian = factor * self.cost + sum(
            (ca.dot(a, b) for a, b in zip(y, values[1:], strict=True) if a.numel()), ca.SX(0)
        )
        jacobians = [ca.densify(ca.jacobian(values[0], w))]
        jacobians += [ca.jacobian(f, w) for f in values[1:]]
        hessian = ca.tril(ca.hessian(lagrangian, w)[0])
        if not self.sparse:
            jacobians, hessian = [ca.densify(f) for f in jacobians], ca.densify(hessian)
        return (
            ca.Function("values", [self.x, self.v], [ca.densify(f) for f in values]),
            ca.Function("jacobians", [self.x, self.v], jacobians),
            ca.Function("hessian", [self.x, self.v, factor, *y], [hessian]),
        )


@dataclass
class Problem:
    """Stages by kind, bounds of all variables (stage by stage, x before v) and of g, a guess."""

    name: str
    kinds: Sequence[Kind]
    order: Sequence[int]  # the kind of each stage
    lower: Array
    upper: Array
    least: Array
    most: Array
    guess: Array
    scale: Array | None = None

    @property
    def stages(self) -> list[Kind]:
        return [self.kinds[i] for i in self.order]

    def places(self) -> list[tuple[int, int]]:
        """Where the variables and the rows of g of each stage begin."""
        places, w, s = [], 0, 0
        for kind in self.stages:
            places.append((w, s))
            nx, nv, _, ng = kind.size
            w, s = w + nx + nv, s + ng
        return places

    @cached_property
    def program(self) -> dict[str, Any]:
        """The problem as one program, rows in the order of the solver in C."""
        w = ca.MX.sym("w", len(self.guess))
        cost, rows, lower, upper = ca.MX(0), [], [], []
        stages, places = self.stages, self.places()
        evaluate = {i: kind.functions[0] for i, kind in enumerate(self.kinds)}
        for k, (kind, (at, s)) in enumerate(zip(stages, places, strict=True)):
            nx, nv, ne, ng = kind.size
            f, e, d, g = evaluate[self.order[k]](w[at : at + nx], w[at + nx : at + nx + nv])
            cost += f
            after = stages[k + 1].size[0] if k + 1 < len(stages) else 0
            if after:
                ahead = places[k + 1][0]
                d = d - w[ahead : ahead + after]
            rows += [e, d, g] if after else [e, g]
            lower += [np.zeros(ne + after), self.least[s : s + ng]]
            upper += [np.zeros(ne + after), self.most[s : s + ng]]
        return {
            "nlp": {"x": w, "f": cost, "g": ca.vertcat(*rows)},
            "lbg": np.concatenate(lower),
            "ubg": np.concatenate(upper),
        }

    def ipopt(self, **options: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        """Solve by IPOPT, without relaxed bounds; return its solution and statistics."""
        solver = ca.nlpsol("s", "ipopt", self.program["nlp"], {**IPOPT, **options})
        bounds = {name: self.program[name] for name in ("lbg", "ubg")}
        solution = solver(x0=self.guess, lbx=self.lower, ubx=self.upper, **bounds)
        return {name: np.asarray(value).ravel() for name, value in solution.items()}, solver.stats()

    def residuals(self, w: Array, y: Array, below: Array, above: Array) -> tuple[float, float, float]:
        """Stationarity, violation and complementarity by CasADi's derivatives."""
        nlp = self.program["nlp"]
        multipliers = ca.MX.sym("y", nlp["g"].numel())
        gradient = ca.gradient(nlp["f"] + ca.dot(multipliers, nlp["g"]), nlp["x"])
        evaluate = ca.Function("kkt", [nlp["x"], multipliers], [gradient, nlp["g"]])
        derivative, rows = (np.asarray(a).ravel() for a in evaluate(w, y))
        bounds = self.program["lbg"], self.program["ubg"]
        return measure((w, self.lower, self.upper, below, above), (rows, *bounds), y, derivative)

    @property
    def sizes(self) -> list[tuple[int, int, int, int]]:
        return [kind.size for kind in self.stages]

    @property
    def extras(self) -> list[Extra]:
        return [kind.extra for kind in self.stages]

    def callbacks(self, library: Library, fault: Fault | None) -> list[Any]:
        """Context, values, Jacobians, Hessian."""
        sizes, ffi, r = self.sizes, library.ffi, library.real
        after = [size[0] for size in sizes[1:]] + [0]
        functions = [kind.functions for kind in self.kinds]
        calls = [0, 0, 0]

        def run(k: int, which: int, inputs: list[tuple[Any, int]], outputs: list[Any]) -> int:
            calls[which] += k == 0
            arguments = [library.view(p, n).astype(np.float64) if n else ca.DM(0, 1) for p, n in inputs]
            results = functions[self.order[k]][which].call(arguments)
            for pointer, result in zip(outputs, results, strict=True):
                if result.nnz():
                    library.view(pointer, result.nnz())[:] = result.nonzeros()
            if fault and fault(FUNCTIONS[which], calls[which], k):
                library.view(outputs[0], results[0].nnz())[-1] = np.nan
            return 0

        def values(_: Any, k: int, x: Any, v: Any, f: Any, e: Any, d: Any, g: Any) -> int:
            return run(k, 0, [(x, sizes[k][0]), (v, sizes[k][1])], [f, e, d, g])

        def jacobians(_: Any, k: int, x: Any, v: Any, f: Any, e: Any, d: Any, g: Any) -> int:
            return run(k, 1, [(x, sizes[k][0]), (v, sizes[k][1])], [f, e, d, g])

        def hessian(_: Any, k: int, x: Any, v: Any, factor: float, e: Any, d: Any, g: Any, h: Any) -> int:
            nx, nv, ne, ng = sizes[k]
            inputs = [(x, nx), (v, nv), (ffi.new(f"{r}[1]", [factor]), 1), (e, ne), (d, after[k]), (g, ng)]
            return run(k, 2, inputs, [h])

        first, out = f"int(void *, int, const {r} *, const {r} *", f", {r} *, {r} *, {r} *, {r} *)"
        multipliers = f", {r}, const {r} *, const {r} *, const {r} *, {r} *)"
        return [
            ffi.NULL,
            ffi.callback(first + out, values, error=1),
            ffi.callback(first + out, jacobians, error=1),
            ffi.callback(first + multipliers, hessian, error=1),
        ]


@dataclass
class Quadratic:
    """Quadratic costs and linear rows with numbers for each stage; evaluated in C (quadratic.c)."""

    sizes: list[tuple[int, int, int, int]]
    H: list[Array]
    q: list[Array]
    F: list[Array]  # d = F (x, v) + b
    b: list[Array]
    E: list[Array]
    e: list[Array]
    G: list[Array]
    lower: Array
    upper: Array
    least: Array
    most: Array
    guess: Array
    scale: Array | None = None
    inner: list[int] | None = None  # of each stage
    sparse: bool = False  # nonzeros by patterns, which stages of the same sizes share

    @cached_property
    def extras(self) -> list[Extra]:
        inner = self.inner or [0] * len(self.sizes)
        nexts = [size[0] for size in self.sizes[1:]] + [0]
        keys = list(zip(self.sizes, nexts, inner, strict=True))
        known: dict[Any, Extra] = {}
        for key in set(keys):
            alike = [k for k, other in enumerate(keys) if other == key]
            parts = [sum(np.abs(m[k]) for k in alike) for m in (self.E, self.F, self.G, self.H)]
            parts[3] = np.tril(parts[3])
            columns = [sp.csc_array(np.asarray(part)) for part in parts]
            patterns = tuple((c.indptr.tolist(), c.indices.tolist()) for c in columns)
            known[key] = Extra(key[2], patterns if self.sparse else None)
        return [known[key] for key in keys]

    def callbacks(self, library: Library, _: Fault | None) -> list[Any]:
        parts = zip(self.H, self.q, self.F, self.b, self.E, self.e, self.G, strict=True)
        stages = [np.concatenate([np.asarray(a).ravel(order="F") for a in stage]) for stage in parts]
        starts = np.concatenate([[0], np.cumsum([len(s) for s in stages])])
        data = library.numbers(np.concatenate(stages))
        ffi = library.ffi
        sizes, patterns = lay_sizes(library, self.sizes, self.extras)
        start = ffi.new("long[]", [int(i) for i in starts])
        context = ffi.new("quadratic *", [sizes, start, library.pointer(data)])
        self.kept = data, sizes, patterns, start, context
        lib = library.lib
        return [context, lib.quadratic_values, lib.quadratic_jacobians, lib.quadratic_hessian]

    @cached_property
    def matrices(self) -> tuple[Any, Array, Any, Array, Array]:
        """P, q, A and bounds of A w: the cost w.P w / 2 + q.w, rows in the order of the solver."""
        n = sum(nx + nv for nx, nv, _, _ in self.sizes)
        rows, lower, upper, at, s = [], [], [], 0, 0
        for k, (nx, nv, _, ng) in enumerate(self.sizes):
            size, after = nx + nv, len(self.b[k])
            place = sp.eye_array(size, n, k=at, format="csr")
            ahead = sp.eye_array(after, n, k=at + size, format="csr")
            rows += [self.E[k] @ place, self.F[k] @ place - ahead, self.G[k] @ place]
            lower += [-self.e[k], -self.b[k], self.least[s : s + ng]]
            upper += [-self.e[k], -self.b[k], self.most[s : s + ng]]
            at, s = at + size, s + ng
        P: Any = sp.block_diag(self.H, format="csc")
        A = sp.vstack([sp.csr_array(r) for r in rows], format="csc")
        return P, np.concatenate(self.q), A, np.concatenate(lower), np.concatenate(upper)

    def ipopt(self, **options: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        """Solve by IPOPT, without relaxed bounds; return its solution and statistics."""
        P, q, A, lower, upper = self.matrices
        w = ca.MX.sym("w", len(q))
        nlp: dict[str, Any] = {"x": w, "f": ca.dot(w, ca.DM(P) @ w) / 2 + ca.dot(ca.DM(q), w), "g": ca.DM(A) @ w}
        solver = ca.nlpsol("s", "ipopt", nlp, {**IPOPT, **options})
        solution = solver(x0=self.guess, lbx=self.lower, ubx=self.upper, lbg=lower, ubg=upper)
        return {name: np.asarray(value).ravel() for name, value in solution.items()}, solver.stats()

    def residuals(self, w: Array, y: Array, below: Array, above: Array) -> tuple[float, float, float]:
        P, q, A, lower, upper = self.matrices
        gradient = P @ w + q + A.T @ y
        return measure((w, self.lower, self.upper, below, above), (A @ w, lower, upper), y, gradient)


def measure(
    variables: tuple[Array, Array, Array, Array, Array], rows: tuple[Array, Array, Array], y: Array, gradient: Array
) -> tuple[float, float, float]:
    """Stationarity, violation and complementarity, from the gradient of cost and rows."""
    w, lower, upper, below, above = variables
    value, least, most = rows
    pairs = [
        (w - lower, below),
        (upper - w, above),
        (value - least, np.maximum(-y, 0)),
        (most - value, np.maximum(y, 0)),
    ]
    violation = max(float(-d.min(initial=0.0)) for d, _ in pairs)
    products = [np.abs(np.where(d < INFINITE / 2, d, 1.0) * z) for d, z in pairs]
    assert min([*below, *above]) >= 0
    return float(np.abs(gradient - below + above).max()), violation, max(float(p.max(initial=0)) for p in products)


@dataclass
class Answer:
    """Status, iterate and figures that the solver in C returned."""

    status: str
    w: Array
    y: Array
    below: Array
    above: Array
    result: Any
    path: list[tuple[Any, ...]]

    @property
    def point(self) -> tuple[Array, Array, Array, Array]:
        return self.w, self.y, self.below, self.above


class Solver:
    """The solver in C for one problem."""

    def __init__(
        self, library: Library, problem: Problem | Quadratic, fault: Fault | None = None, team: Any = None
    ) -> None:
        """`fault` spoils results of a problem with callbacks to CasADi; `team` is one of C's."""
        self.library, self.problem = library, problem
        self.path: list[tuple[Any, ...]] = []
        self.seconds = 0.0
        ffi, numbers = library.ffi, library.numbers
        self.size, self.patterns = lay_sizes(library, problem.sizes, problem.extras)
        self.lower, self.upper = numbers(problem.lower), numbers(problem.upper)
        self.least, self.most = numbers(problem.least), numbers(problem.most)
        self.scale = None if problem.scale is None else numbers(problem.scale)
        self.functions = problem.callbacks(library, fault)
        watchers = self._watchers()
        pointers = [library.pointer(a) for a in (self.lower, self.upper, self.least, self.most, self.scale)]
        self.c: Any = ffi.new(
            "mbs_stages_problem *",
            [len(problem.sizes), self.size, *self.functions, *watchers, *pointers, team or ffi.NULL],
        )
        self.kept = watchers
        self.bytes = library.lib.mbs_stages_bytes(self.c)
        assert self.bytes > 0
        self._create()
        self.set(w=problem.guess)

    def _create(self) -> None:
        """Make the solver in a workspace between canaries."""
        ffi = self.library.ffi
        self.workspace = ffi.new("char[]", self.bytes + 2 * len(CANARY) + 64)
        base = int(ffi.cast("uintptr_t", self.workspace))
        self.offset = -(base + len(CANARY)) % 64 + len(CANARY)
        for at in (self.offset - len(CANARY), self.offset + self.bytes):
            ffi.memmove(self.workspace + at, CANARY, len(CANARY))
        self.solver = self.library.lib.mbs_stages_create(self.c, self.workspace + self.offset, self.bytes)
        assert self.solver != ffi.NULL
        self.point = self.library.lib.mbs_stages_iterate(self.solver)

    def _watchers(self) -> list[Any]:
        def watch(_: Any, p: Any) -> None:
            self.path.append(
                (p.iteration, p.restoring, p.cost, p.violation, p.stationarity, p.barrier, p.step, p.curvature)
            )

        def clock(_: Any) -> float:
            self.seconds += 1.0
            return self.seconds

        ffi = self.library.ffi
        return [
            ffi.callback("void(void *, const mbs_stages_progress *)", watch),
            ffi.callback("double(void *)", clock),
        ]

    def set(self, **arrays: Array) -> None:
        """Write parts of the iterate."""
        for name, value in arrays.items():
            self.library.view(getattr(self.point, name), len(value))[:] = value

    def get(self, name: str) -> Array:
        n = self.point.rows if name == "y" else self.point.variables
        return np.array(self.library.view(getattr(self.point, name), n), dtype=np.float64)

    def untouched(self) -> bool:
        """Whether nothing was written beside the workspace."""
        buffer = self.library.ffi.buffer(self.workspace)
        places = (self.offset - len(CANARY), self.offset + self.bytes)
        return all(bytes(buffer[at : at + len(CANARY)]) == CANARY for at in places)

    def _options(self, options: dict[str, Any]) -> Any:
        given = self.library.ffi.new("mbs_stages_options *", self.library.lib.mbs_stages_default_options())
        for name, value in options.items():
            setattr(given, name, value)
        return given

    def prepare(self, *, shift: bool = False, **options: Any) -> tuple[str, Any]:
        """Prepare a step in real time; return its status and its figures."""
        result = self.library.lib.mbs_stages_prepare(self.solver, self._options(options), int(shift))
        assert self.untouched()
        return STATUS[result.status], result

    def feedback(self, first: Array) -> tuple[str, Array, Any]:
        """Make the step for the first state; return its status, the variables of stage 0 and its figures."""
        nv = self.problem.sizes[0][1]
        memory, v = self.library.numbers(first), self.library.numbers(np.zeros(nv + 1))
        v[nv] = np.pi  # behind the last number
        result = self.library.lib.mbs_stages_feedback(
            self.solver, self.library.pointer(memory), self.library.pointer(v)
        )
        assert self.untouched()
        assert v[nv] == self.library.numbers(np.array([np.pi]))[0]
        return STATUS[result.status], v[:nv].astype(np.float64), result

    def solve(self, **options: Any) -> Answer:
        given = self._options(options)
        self.path, self.seconds = [], 0.0
        result = self.library.lib.mbs_stages_solve(self.solver, given)
        assert self.untouched()
        w, y, below, above = (self.get(n) for n in ("w", "y", "below", "above"))
        return Answer(STATUS[result.status], w, y, below, above, result, self.path)


def show(answer: Answer) -> str:
    """Return a table of the iterations."""
    rows = [f"{a:4d}{'r' if b else ' '} " + " ".join(f"{x:10.2e}" for x in rest) for a, b, *rest in answer.path]
    return "\n".join(rows)


def close(a: np.ndarray, b: np.ndarray, tolerance: float) -> bool:
    return bool(np.abs(a - b).max(initial=0.0) <= tolerance * (1 + np.abs(b).max(initial=0.0)))


def clashes(answer: Answer) -> list[tuple[int, str, int]]:
    """The rows that clash, the worst first."""
    listed = answer.result.clash[0 : min(answer.result.clashes, 8)]
    return [(c.stage, "edg"[c.kind], c.row) for c in listed]
