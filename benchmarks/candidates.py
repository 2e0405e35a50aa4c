"""The compared candidates: functions of one mechanism, each by several authors, all in CasADi's contract."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import TypeAdapter

from mbsrun.measuring.functions import Function

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
LARGE, LARGEST = 20_000, 50_000  # operations above which CasADi's C is compiled by -O1, and not compiled


@dataclass(frozen=True)
class Candidate:
    """One way to compute one function."""

    author: str
    function: str  # the name of the compared kernel
    way: str  # distinguishes candidates of one author for the same function
    flops: int | None  # + - * / and roots; None where they are not known
    code: Function | None  # None: counted only
    sines: Sines = "libm"
    guards: int = 0  # operations of the tests of pivots, not included in flops


_READER = TypeAdapter(Candidate)


def write_candidate(candidate: Candidate) -> dict[str, Any]:
    """Return a candidate as JSON stores it."""
    content: dict[str, Any] = _READER.dump_python(candidate, mode="json")
    return content


def read_candidate(content: Mapping[str, Any]) -> Candidate:
    """Read a candidate that `write_candidate` wrote."""
    return _READER.validate_python(content)
