"""The manifest of a controller's folder: what the Python side, and a reader, know of the C."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from mbsgen.errors import Fault, InputError
from mbsgen.manifest import FILE_NAME

FORMAT: Literal["mbsrun controller 1"] = "mbsrun controller 1"
NAME = r"^[A-Za-z][A-Za-z0-9_]*$"
SOURCE = r"^[A-Za-z0-9_]+\.c$"


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", ser_json_inf_nan="constants")


class Entry(_Part):
    """One number of the run-time data; a bound that is not there is None."""

    name: str
    unit: str
    value: float | None
    note: str = ""


class Data(_Part):
    """A field of the run-time data."""

    name: str = Field(pattern=NAME)
    meaning: str
    size: int = Field(ge=0)
    rows: int = Field(ge=0)  # of a matrix; 0: a vector
    entries: tuple[Entry, ...]  # none of a matrix


class Quantity(_Part):
    """An entry of states or inputs."""

    name: str
    unit: str


class Memory(_Part):
    """Bytes that a controller needs, on a machine with pointers of 8 bytes."""

    double: int
    single: int


class Manifest(_Part):
    """A controller's folder, described."""

    format: Literal["mbsrun controller 1"]
    generator: str
    prefix: str = Field(pattern=NAME)  # every name in C begins with it
    symbols: str = Field(pattern=NAME)  # every symbol in the object files begins with it: the prefix, and a hash
    problem: str
    problem_hash: str
    model: str
    model_hash: str
    intervals: int = Field(ge=1)
    horizon: float | None  # s; None where it is free
    states: tuple[Quantity, ...]
    inputs: tuple[Quantity, ...]
    data: tuple[Data, ...]
    numbers: dict[str, float] = {}  # of the mechanism, which the problem chose; parameters or theta have them too
    delays: tuple[int, ...] = ()  # intervals until each input acts that is given now; empty: all act at once
    predicts: bool
    cost: float  # of the optimum that the check expects
    scale: float = Field(gt=0)  # the solver minimises the cost times this number
    barrier: float = Field(ge=0)  # of steps in real time, in the unit of the scaled cost; 0: the solver's own default
    memory: Memory
    functions: tuple[str, ...]  # in C, that the tables call: kernels and expressions
    sources: tuple[str, ...]  # C files of the library
    files: tuple[str, ...]  # every file of the folder


def write(manifest: Manifest) -> str:
    """Return the text of a manifest's file."""
    return manifest.model_dump_json(indent=2) + "\n"


def read(folder: Path) -> Manifest:
    """Read the manifest of a folder. Raises InputError where it is missing or no controller's."""
    path = folder / FILE_NAME
    try:
        return Manifest.model_validate_json(path.read_bytes())
    except OSError as error:
        finding = (
            "there is no such file" if isinstance(error, FileNotFoundError) else f"cannot be read: {error.strerror}"
        )
        remedy = "write the folder with `mbsrun controller PROBLEM -o DIR`"
        raise InputError([Fault(str(path), 0, "", finding, remedy)]) from None
    except ValidationError as error:
        faults = [
            Fault(str(path), 0, ".".join(map(str, e["loc"])), e["msg"], "write the folder again with this mbsrun")
            for e in error.errors()
        ]
        raise InputError(faults) from None
