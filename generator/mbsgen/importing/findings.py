"""Findings of an import: faults, all together, and notices of differences between model and file."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

from mbsgen.documents import abbreviate, refuse
from mbsgen.errors import Fault, InputError
from mbsgen.importing.markup import Element

MAX_DIGITS = 64  # characters of one number
SMALLEST, LARGEST = 1e-60, 1e60  # products of a few numbers neither vanish nor overflow
UNBOUNDED = 1e15  # of limits: larger numbers stand for none
_NUMBER = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?")
_INFINITE = re.compile(r"[-+]?inf(inity)?", re.IGNORECASE)
_XACRO = re.compile(r"\$[{(]")
UNEXPANDED = "this is xacro: run `xacro FILE > robot.urdf` first"


@dataclass(frozen=True)
class Notice:
    """A change or omission of a part of the file; `alters`: the model moves differently from the file."""

    file: str
    line: int  # 0: the whole file
    path: str
    text: str
    alters: bool
    undrawn: bool = False  # a picture lacks the element

    def __str__(self) -> str:
        place = f"{self.file}:{self.line}: {self.path}" if self.line else self.file
        return f"{place}: {'warning: ' if self.alters else ''}{self.text}"

    def without_folder(self) -> Notice:
        """Return the notice without the folder, so that it is the same on every machine."""
        return replace(self, file=re.split(r"[/\\]", self.file)[-1])


class Findings:
    """Collects faults and notices."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.faults: list[Fault] = []
        self.notices: list[Notice] = []

    def fault(self, element: Element, finding: str, remedy: str) -> None:
        """Add a fault of an element."""
        self.faults.append(element.fault(finding, remedy))

    def tell(self, element: Element, text: str) -> None:
        """Add a notice on an element."""
        self.notices.append(Notice(element.file, element.line, element.path, text, alters=False))

    def omit(self, element: Element, text: str) -> None:
        """Add a notice on an element that pictures lack."""
        self.notices.append(Notice(element.file, element.line, element.path, text, alters=False, undrawn=True))

    def warn(self, element: Element, text: str) -> None:
        """Add a warning: the model moves differently from an element of the file."""
        self.notices.append(Notice(element.file, element.line, element.path, text, alters=True))

    def sum_up(self, text: str, *, alters: bool = False) -> None:
        """Add a notice on the file as a whole; `alters`: the model moves differently from the file."""
        self.notices.append(Notice(self.file, 0, "", text, alters=alters))

    def refuse(self) -> InputError:
        """Return the error of all faults."""
        return refuse(self.faults)

    def numbers(
        self,
        element: Element,
        name: str,
        default: tuple[float, ...],
        *,
        count: int | None = None,
        attributes: Mapping[str, str] | None = None,
    ) -> tuple[float, ...]:
        """Read an attribute of `count` numbers, by default as many as the default has; faulty numbers become the
        default.

        `attributes` include inherited ones.
        """
        text = (element.attributes if attributes is None else attributes).get(name)
        if text is None:
            return default
        words = text.split()
        wanted = len(default) if count is None else count
        if is_xacro(text):
            self.fault(element, f"{name} is {abbreviate(text)}", UNEXPANDED)
            return default
        if len(words) != wanted:
            finding = f"{name} has {len(words)} numbers" if len(words) <= MAX_DIGITS else f"{name} is too long"
            self.fault(element, f"{finding}: {abbreviate(text)}", f"give {wanted}")
            return default
        values = [read_number(word) for word in words]
        if any(map(math.isnan, values)):
            remedy = f"give numbers such as 0.3 or 1e-3, up to {LARGEST:g} in size"
            self.fault(element, f"{name} is {abbreviate(text)}", remedy)
            return default
        return tuple(values)

    def number(self, element: Element, name: str, default: float, attributes: Mapping[str, str] | None = None) -> float:
        """Read an attribute of one number."""
        return self.numbers(element, name, (default,), attributes=attributes)[0]

    def bound(self, element: Element, name: str, attributes: Mapping[str, str] | None = None) -> float | None:
        """Read an attribute that bounds something; None where it is missing or infinite, or too large to matter."""
        text = (element.attributes if attributes is None else attributes).get(name)
        if text is None or _INFINITE.fullmatch(word := text.strip()):
            return None
        if len(word) <= MAX_DIGITS and _NUMBER.fullmatch(word) and abs(float(word)) > UNBOUNDED:
            return None
        return self.number(element, name, 0.0, {name: text})

    def choice(self, element: Element, name: str, words: tuple[str, ...], attributes: Mapping[str, str]) -> str:
        """Read an attribute that is one of some words; the first is the default."""
        word = attributes.get(name, words[0])
        if word not in words:
            self.fault(element, f"{name} is {abbreviate(word)}", f"give {', '.join(words)}")
            return words[0]
        return word


def is_xacro(text: str) -> bool:
    """Test whether a text has an expression or a command of xacro, which nobody has expanded."""
    return _XACRO.search(text) is not None


def read_number(word: str) -> float:
    """Read a number of ordinary size; nan for anything else."""
    if len(word) > MAX_DIGITS or not _NUMBER.fullmatch(word):
        return math.nan
    value = float(word)
    if abs(value) < SMALLEST:
        return 0.0  # no -0
    return value if abs(value) <= LARGEST else math.nan
