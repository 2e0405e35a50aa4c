"""A tyre property file (TIR) -> the coefficients of the Magic Formula of MF-Tyre 5.2, or all that is wrong with it.

A line is a section, `[LATERAL_COEFFICIENTS]`, a number or a quoted word, `PCY1 = 1.3 $ comment`, a comment from `!` or
`$`, or a row of a table, which is not read. Units must be SI. Files of later formulas are refused: their coefficients
have other meanings.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from mbsgen.documents import abbreviate, read_bytes, refuse
from mbsgen.errors import Fault
from mbsgen.model.tyres import MAGIC, NEEDED

MAX_BYTES = 1 << 18
LARGEST = 1e9  # of a number
VERTICAL = ("UNLOADED_RADIUS", "VERTICAL_STIFFNESS", "VERTICAL_DAMPING")
_FITS = (6, 21, 52)  # the numbers that say MF-Tyre 5.2
_FORMATS = ("PAC2002", "MF_05", "MF-TYRE", "MF52", "USER")
_UNITS = {
    "LENGTH": ("meter", "meters", "metre", "m"),
    "FORCE": ("newton", "n"),
    "ANGLE": ("radian", "radians", "rad"),
    "MASS": ("kg", "kilogram"),
    "TIME": ("second", "seconds", "sec", "s"),
}
_LINE = re.compile(r"(\w+)\s*=\s*('[^']*'|\"[^\"]*\"|[^\s$!]*)\s*(?:[$!].*)?")
_UNUSED = re.compile(r"(?:P[A-Z]{2}|R[A-Z]{2}|Q[A-Z]{2}|SSZ|PPX|PPY)\d+")  # names of coefficients


@dataclass(frozen=True, eq=False)
class TyreFile:
    """The numbers of a file."""

    file: str
    magic: Mapping[str, float]  # by the names of MAGIC, as far as the file has them
    vertical: Mapping[str, float]  # by the names of VERTICAL, likewise
    unused: tuple[str, ...]  # coefficients that are not 0 and that no formula here has


@dataclass
class _Reading:
    file: str
    numbers: dict[str, float] = field(default_factory=dict)
    words: dict[str, str] = field(default_factory=dict)
    lines: dict[str, int] = field(default_factory=dict)
    faults: list[Fault] = field(default_factory=list)

    def find(self, key: str, finding: str, remedy: str) -> None:
        self.faults.append(Fault(self.file, self.lines.get(key, 0), key, finding, remedy))


def read_tyre(path: Path) -> TyreFile:
    """Read a file. Raises InputError with every fault of it."""
    text = read_bytes(path, MAX_BYTES).decode("latin-1")  # comments have any encoding
    reading = _Reading(str(path))
    for number, line in enumerate(text.splitlines(), 1):
        _read_line(reading, number, line.strip())
    for key, finding, remedy in _list_faults(reading):
        reading.find(key, finding, remedy)
    if reading.faults:
        raise refuse(reading.faults)
    numbers = reading.numbers
    unused = [x for x, value in numbers.items() if value and x not in MAGIC and _UNUSED.fullmatch(x)]
    return TyreFile(
        reading.file,
        {x: numbers[x] for x in MAGIC if x in numbers},
        {x: numbers[x] for x in VERTICAL if x in numbers},
        tuple(unused),
    )


def _read_line(reading: _Reading, number: int, line: str) -> None:
    """Read one line: a number or a word by its key."""
    if not (found := _LINE.fullmatch(line)):
        return
    key, value = found[1].upper(), found[2]
    if key in reading.lines:
        if key in MAGIC:
            reading.find(key, f"given again in line {number}", "keep one of them")
        return
    reading.lines[key] = number
    if value[:1] in ("'", '"'):
        reading.words[key] = value[1:-1].strip()
        return
    try:
        reading.numbers[key] = float(value)
    except ValueError:
        if key in MAGIC or key in VERTICAL:
            reading.find(key, f"found {abbreviate(value)}", "give a number")
            return
    if key in reading.numbers and not abs(reading.numbers[key]) <= LARGEST:  # nan, too
        found_value = reading.numbers.pop(key)
        if key in MAGIC or key in VERTICAL:
            size = f"{found_value:g}" if not math.isnan(found_value) else "no number"
            reading.find(key, f"found {size}", f"give a number of at most {LARGEST:g}")


def _list_faults(reading: _Reading) -> Iterator[tuple[str, str, str]]:
    """List what is wrong with the whole: the kind of formulas, units, coefficients that are missing."""
    if not reading.lines:
        yield "", "this is no tyre property file", "give a TIR file, with lines such as PCY1 = 1.3"
        return
    fit, form = reading.numbers.get("FITTYP"), reading.words.get("PROPERTY_FILE_FORMAT", "").upper()
    if fit is not None and fit not in _FITS:
        yield "FITTYP", f"formulas of type {fit:g}", "give a file of MF-Tyre 5.2 (FITTYP 6) or PAC2002"
    elif fit is None and form not in _FORMATS:
        key = "PROPERTY_FILE_FORMAT"
        finding = f"formulas of {abbreviate(form)}" if form else "neither a format nor a FITTYP"
        yield key, finding, "give a file of MF-Tyre 5.2 (FITTYP 6) or PAC2002"
    for unit, names in _UNITS.items():
        if (word := reading.words.get(unit)) is not None and word.lower() not in names:
            yield unit, f"a unit {abbreviate(word)}", f"convert the file to SI: {names[0]}"
    if reading.numbers.get("FNOMIN", 1.0) <= 0:
        yield "FNOMIN", f"found {reading.numbers['FNOMIN']:g}", "give more than 0"
    for key in NEEDED:
        if key not in reading.lines:
            yield key, "missing", "give it: the formulas need it"
