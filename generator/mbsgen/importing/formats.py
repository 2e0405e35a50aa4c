"""File formats that models are imported from: one entry each in FORMATS, and a reader in a separate file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from mbsgen.documents import abbreviate
from mbsgen.errors import Fault, InputError
from mbsgen.expressions import Number
from mbsgen.importing.choices import Choices, Imported, MasslessError
from mbsgen.importing.digits import list_numbers
from mbsgen.importing.findings import Findings, Notice
from mbsgen.importing.markup import Element, read_markup
from mbsgen.model.digits import find_tolerance, list_geometry

DEFAULT = Choices()


@dataclass(frozen=True)
class Source:
    """A file to import."""

    path: Path

    @cached_property
    def root(self) -> Element:
        """The root element of an XML file. Raises InputError for any other file."""
        return read_markup(self.path)


@dataclass(frozen=True)
class Format:
    """A file format."""

    name: str  # in help texts
    suffixes: tuple[str, ...]  # of files that are imported; formats may share them
    mark: str  # by which a user recognises a file, in messages
    recognise: Callable[[Source], bool]  # may raise InputError
    read: Callable[[Source, Choices], Imported]  # raises InputError with all faults of the file


STUDY = ".omoco"  # of OpenSim Moco: `mbsgen import` makes a problem and a model of it
_MARKUP = (".urdf", ".xml", ".mjcf", ".xacro", ".sdf", ".osim")  # the root element shows the format
_ADVICE = {
    "mujocoinclude": "import the file that includes this one",
}


def make_markup_format(name: str, tag: str, read: Callable[[Element, Choices, Findings], Imported]) -> Format:
    """Make the entry of a format of XML, whose root element has this tag."""
    return Format(
        name,
        _MARKUP,
        f"<{tag}>",
        lambda source: source.root.tag == tag,
        lambda source, choices: read(source.root, choices, Findings(str(source.path))),
    )


def _read_urdf(root: Element, choices: Choices, findings: Findings) -> Imported:
    from mbsgen.importing.urdf.reading import read_urdf  # here and below: most models are no robots' files

    return read_urdf(root, choices, findings)


def _read_mjcf(root: Element, choices: Choices, findings: Findings) -> Imported:
    from mbsgen.importing.mjcf.reading import read_mjcf

    return read_mjcf(root, choices, findings)


def _read_sdf(root: Element, choices: Choices, findings: Findings) -> Imported:
    from mbsgen.importing.sdf.reading import read_sdf

    return read_sdf(root, choices, findings)


def _read_osim(root: Element, choices: Choices, findings: Findings) -> Imported:
    from mbsgen.importing.osim.reading import read_osim

    return read_osim(root, choices, findings)


FORMATS: tuple[Format, ...] = (
    make_markup_format("URDF", "robot", _read_urdf),
    make_markup_format("MJCF", "mujoco", _read_mjcf),
    make_markup_format("SDF", "sdf", _read_sdf),
    make_markup_format("OpenSim", "OpenSimDocument", _read_osim),
)


def list_formats() -> str:
    """List the names of all formats, in words."""
    *most, last = (known.name for known in FORMATS)
    return f"{', '.join(most)} or {last}" if most else last


def is_foreign(path: Path) -> bool:
    """Test by its name whether a file is one to import."""
    return path.suffix.lower() == STUDY or any(path.suffix.lower() in known.suffixes for known in FORMATS)


def _read(known: Format, source: Source, choices: Choices) -> Imported:
    """Read a file; joints that move nothing are held, if the choices ask for it, until none is left."""
    held: list[str] = []
    while True:
        try:
            found = known.read(source, replace(choices, locked=(*choices.locked, *((name, 0.0) for name in held))))
        except MasslessError as error:
            held += error.joints
        else:
            break
    if not held:
        return found
    notice = Notice(str(source.path), 0, "", f"held at 0, since they move nothing: {', '.join(held)}", alters=True)
    return replace(found, notices=(notice, *found.notices))


def _tolerate(found: Imported, source: Source, choices: Choices) -> Imported:
    """Return a model with loops with the tolerance of the file's digits, where it is not the one of the model's."""
    model, given = found.model, choices.loop_tolerance
    if not (model.loops or model.constraints):
        return found
    tolerance = find_tolerance(list_numbers(source.root)) if given is None else given
    if given is None and tolerance == find_tolerance(list_geometry(model)):
        return found
    return replace(found, model=replace(model, loop_tolerance=Number(tolerance)))


def import_model(path: Path, choices: Choices = DEFAULT) -> Imported:
    """Read a file of one of FORMATS as a model. Raises InputError with all faults of the file."""
    source, suffix = Source(path), path.suffix.lower()
    if suffix == STUDY:
        remedy = f"make a problem and its model: mbsgen import {path.name} -o {path.stem}.ocp.yaml"
        raise InputError([Fault(str(path), 0, "", "the file is a study of OpenSim Moco, and no model", remedy)])
    likely = [known for known in FORMATS if suffix in known.suffixes] or FORMATS
    for known in likely:
        if known.recognise(source):
            return _tolerate(_read(known, source, choices), source, choices)
    *most, last = (f"{known.name} ({known.mark})" for known in likely)
    remedy = f"give a file of {', '.join(most)}{' or ' if most else ''}{last}"
    if suffix not in _MARKUP:
        raise InputError([Fault(str(path), 0, "", "the file is of no format that is read", remedy)])
    tag = source.root.tag
    raise InputError([source.root.fault(f"the file is <{abbreviate(tag)[1:-1]}>", _ADVICE.get(tag, remedy))])
