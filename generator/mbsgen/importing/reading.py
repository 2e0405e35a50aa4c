"""A file of another format -> Imported, by its root element."""

from __future__ import annotations

from pathlib import Path

from mbsgen.documents import abbreviate
from mbsgen.errors import InputError
from mbsgen.importing.drafting import Choices, Imported
from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import read_markup
from mbsgen.importing.mjcf import read_mjcf
from mbsgen.importing.urdf import read_urdf

READERS = {"robot": read_urdf, "mujoco": read_mjcf}
SUFFIXES = (".urdf", ".xml", ".mjcf", ".xacro", ".sdf")
_ADVICE = {"sdf": "SDF is not read; convert it to URDF", "mujocoinclude": "import the file that includes this one"}

DEFAULT = Choices()


def is_foreign(path: Path) -> bool:
    """Tell by its name whether a file is one to import."""
    return path.suffix.lower() in SUFFIXES


def import_model(path: Path, choices: Choices = DEFAULT) -> Imported:
    """Read a URDF or MJCF file as a model. Raises InputError with all faults of the file."""
    root = read_markup(path)
    if root.tag not in READERS:
        remedy = _ADVICE.get(root.tag, "give a file of URDF (<robot>) or MJCF (<mujoco>)")
        raise InputError([root.fault(f"the file is <{abbreviate(root.tag)[1:-1]}>", remedy)])
    return READERS[root.tag](root, choices, Findings(str(path)))
