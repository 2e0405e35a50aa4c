"""What is compared: functions of one mechanism, each by several authors, all in CasADi's contract."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

_INTEGERS = ctypes.POINTER(ctypes.c_longlong)
Array = NDArray[np.float64]
Sines = Literal["libm", "header"]  # of the C library, or of csrc/mbs_sincos.h
OURS, TAPE, SHORT = "mbsgen", "AD of our equations", "short recursion in CasADi"
CASADI, PINOCCHIO = "Pinocchio in CasADi", "Pinocchio"
AUTHORS: Mapping[str, str] = {
    OURS: "the generated kernels",
    TAPE: "the generated equations over CasADi's SX, differentiated by CasADi, with cse, as C",
    SHORT: "short recursions with base inertial parameters in CasADi's SX, with cse, as C",
    CASADI: "Pinocchio's algorithms traced in CasADi's SX, with cse, as C",
    PINOCCHIO: "Pinocchio's algorithms in C++",
}
LARGE, LARGEST = 20_000, 50_000  # operations of CasADi's C from which on it is compiled by -O1, and not compiled


@dataclass(frozen=True)
class Block:
    """A result, or part of one: nonzeros of a matrix, column by column."""

    name: str
    rows: int
    cols: int
    places: tuple[tuple[int, int], ...]

    def scatter(self, nonzeros: Array) -> Array:
        """Give the whole matrix."""
        whole = np.zeros((self.rows, self.cols))
        for (r, c), value in zip(self.places, nonzeros, strict=True):
            whole[r, c] = value
        return whole


@dataclass(frozen=True)
class Face:
    """What a function in CasADi's contract takes and gives."""

    inputs: tuple[str, ...]
    blocks: tuple[Block, ...]
    sz_iw: int = 0  # work space, in numbers
    sz_w: int = 0


@dataclass(frozen=True)
class Code:
    """Where the machine code of a candidate is."""

    library: Path
    symbol: str
    face: Face


@dataclass(frozen=True)
class Candidate:
    """One way to compute one function."""

    author: str
    function: str  # the name of the kernel that it is compared with
    way: str  # tells apart what one author has for the same function
    flops: int | None  # + - * / and roots; None where they are not known
    code: Code | None  # None: counted only
    sines: Sines = "libm"
    guards: int = 0  # operations of tests that pivots stand out of rounding, which flops leave out


def write_candidate(candidate: Candidate) -> dict[str, Any]:
    """Return a candidate as JSON has it."""
    content = asdict(candidate)
    if candidate.code is not None:
        content["code"]["library"] = str(candidate.code.library)
    return content


def read_candidate(content: Mapping[str, Any]) -> Candidate:
    """Return the candidate that `write_candidate` wrote."""
    code = content["code"]
    if code is None:
        return Candidate(**content)
    blocks = (
        Block(b["name"], b["rows"], b["cols"], tuple((r, c) for r, c in b["places"])) for b in code["face"]["blocks"]
    )
    face = Face(tuple(code["face"]["inputs"]), tuple(blocks), code["face"]["sz_iw"], code["face"]["sz_w"])
    return Candidate(**{**content, "code": Code(Path(code["library"]), code["symbol"], face)})


def dense(name: str, rows: int, cols: int) -> Block:
    """Describe a result without structural zeros."""
    return Block(name, rows, cols, tuple((r, c) for c in range(cols) for r in range(rows)))


def load_code(library: Path, symbol: str) -> Code:
    """Describe a function by what its library tells of it."""
    opened = ctypes.CDLL(str(library))

    def ask(what: str, kind: Any, *place: int) -> Any:
        function = opened[f"{symbol}_{what}"]
        function.restype, function.argtypes = kind, [ctypes.c_longlong] * len(place)
        return function(*place)

    names = [ask("name_in", ctypes.c_char_p, i).decode() for i in range(ask("n_in", ctypes.c_longlong))]
    blocks = [
        _read_block(ask("name_out", ctypes.c_char_p, i).decode(), ask("sparsity_out", _INTEGERS, i))
        for i in range(ask("n_out", ctypes.c_longlong))
    ]
    sizes = [ctypes.c_longlong() for _ in range(4)]  # sz_arg, sz_res, sz_iw, sz_w
    opened[f"{symbol}_work"](*map(ctypes.byref, sizes))
    return Code(library, symbol, Face(tuple(names), tuple(blocks), sizes[2].value, sizes[3].value))


def _read_block(name: str, pattern: Any) -> Block:
    """Read a pattern of CasADi's contract: rows, columns, then 1 for a dense matrix, or column pointers and rows."""
    rows, cols = pattern[0], pattern[1]
    if pattern[2]:
        return dense(name, rows, cols)
    pointers = pattern[2 : 3 + cols]
    places = [(pattern[3 + cols + k], c) for c in range(cols) for k in range(pointers[c], pointers[c + 1])]
    return Block(name, rows, cols, tuple(places))


class Call:
    """A candidate, loaded and bound to a pool of states; the results of a call lie in arrays of its own."""

    def __init__(self, candidate: Candidate, code: Code, pool: Mapping[str, Array]) -> None:
        self.candidate = candidate
        self._blocks = code.face.blocks
        self._library = ctypes.CDLL(str(code.library))
        self.address = ctypes.cast(self._library[code.symbol], ctypes.c_void_p)
        unused = np.zeros((len(pool["q"]), 1))  # for results of f, which CasADi's contract passes to its derivatives
        self.inputs = [np.ascontiguousarray(pool.get(name, unused)) for name in code.face.inputs]
        blank = 0.0 if candidate.author == PINOCCHIO else np.nan  # it counts on zeros where branches do not meet
        self.results = [np.full(max(1, len(block.places)), blank) for block in self._blocks]
        self.iw = np.zeros(code.face.sz_iw + 1, dtype=np.int64)
        self.w = np.zeros(code.face.sz_w + 1)

    def evaluate(self, state: int) -> dict[str, Array]:
        """Compute one state's results, as whole matrices."""
        signature = ctypes.CFUNCTYPE(ctypes.c_int, *[ctypes.c_void_p] * 4, ctypes.c_int)
        arg = pointers([x[state:] for x in self.inputs])
        status = signature(self.address.value or 0)(
            ctypes.cast(arg, ctypes.c_void_p),
            ctypes.cast(pointers(self.results), ctypes.c_void_p),
            self.iw.ctypes.data,
            self.w.ctypes.data,
            0,
        )
        if status:
            raise ArithmeticError(f"{self.candidate.author}, {self.candidate.way}: status {status} in state {state}")
        return {
            block.name: block.scatter(values[: len(block.places)])
            for block, values in zip(self._blocks, self.results, strict=True)
        }


def pointers(arrays: Sequence[Array]) -> ctypes.Array[ctypes.c_void_p]:
    """Make a C array of pointers; spare room at its end is for kernels that ask for some."""
    return (ctypes.c_void_p * (len(arrays) + 64))(*(x.ctypes.data for x in arrays))
