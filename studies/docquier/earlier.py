"""Read the attempts and certificates of a page that `--page` wrote, to go on from them in another record.

The archive of a page has every attempt, and no motions; `optima.csv` has the certificates of the lowest optima. The
files may come from anyone: each value is checked, and a fault is reported with its file and line.
"""

from __future__ import annotations

import csv
import io
import lzma
import tarfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from json import dumps
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from mbsgen.errors import Fault, InputError
from mbsrun.ocp.searching.study import Targets
from mbsrun.ocp.solution.record import Attempt, Task
from mbsrun.ocp.solving.certificate import Certificate
from studies.docquier.export import ATTEMPTS, list_columns
from studies.docquier.markdown import ARCHIVE
from studies.docquier.optima import BEYOND, COLUMNS, OPTIMA, UNCHECKED, name_beyond, name_known

LARGEST = 1 << 28  # bytes of a table
CORES = "cores"  # the one number among the columns of the environment
_ATTEMPT, _CERTIFICATE = TypeAdapter(Attempt), TypeAdapter(Certificate)
_FINITE = TypeAdapter(float)
_TASK = ("place_i", "place_j", "inputs", "input_rates", "representation")
_OWN = tuple(field.name for field in fields(Attempt) if field.name != "task")


@dataclass(frozen=True)
class Earlier:
    """The contents of a page: attempts with study and environment, and certificates and turns by name."""

    attempts: tuple[tuple[str, Attempt, str], ...]
    certificates: Mapping[str, Certificate]
    beyond: Mapping[str, float]  # the most turns of a joint beyond its start and its end


def read_page(folder: Path, targets: Targets) -> Earlier:
    """Read both files of a page. Raises InputError, OSError."""
    attempts = tuple(_read_attempts(folder / ARCHIVE))
    rows = list(_read_optima(folder / OPTIMA, targets))
    certificates = {name: certificate for name, certificate, _ in rows if certificate is not None}
    return Earlier(attempts, certificates, {name_beyond(name): x for name, _, x in rows if x is not None})


def _read_attempts(path: Path) -> Iterator[tuple[str, Attempt, str]]:
    for line, row in _list_rows(path, _extract(path), list_columns()):
        try:
            task = {
                "place": (row["place_i"], row["place_j"]),
                "weights": (row["inputs"], row["input_rates"]),
                "representation": row["representation"],
            }
            values = {name: row[name] for name in _OWN if row[name] or name == "turns"}
            attempt = _ATTEMPT.validate_python({"task": task, "cost": None, **values})
        except ValidationError as error:
            raise _refuse(path, line, error) from None
        told = {name: value for name, value in row.items() if name not in list_columns() and value}
        environment = {name: int(value) if name == CORES and value.isdigit() else value for name, value in told.items()}
        yield row["study"], attempt, dumps(environment)


def _extract(path: Path) -> str:
    """Return the table of attempts of an archive."""
    finding = f"it holds no {ATTEMPTS}.csv"
    try:
        with tarfile.open(path, mode="r:xz") as archive:
            entry = archive.getmember(f"{ATTEMPTS}.csv")
            file = archive.extractfile(entry) if entry.size <= LARGEST else None
            if file is not None:
                return file.read().decode("utf-8")
    except KeyError:
        pass
    except (tarfile.TarError, lzma.LZMAError, EOFError, UnicodeDecodeError) as error:
        finding = f"it cannot be read: {error}"
    raise InputError([Fault(str(path), 0, "", finding, "give a folder that --page wrote")])


def _read_optima(path: Path, targets: Targets) -> Iterator[tuple[str, Certificate | None, float | None]]:
    """Yield the name, the certificate and the turns of each optimum. Pages of earlier versions have no turns."""
    places = {(targets.azimuths[i], targets.heights[j]): (i, j) for i, j in targets.places}
    columns = tuple(name for name in COLUMNS if name != BEYOND)
    for line, row in _list_rows(path, path.read_text(encoding="utf-8"), columns):
        try:
            azimuth, height, k1, k2, cost = (_FINITE.validate_python(row[name]) for name in COLUMNS[:5])
            certificate = None if row["second order"] == UNCHECKED else _read_certificate(row)
            beyond = _FINITE.validate_python(row[BEYOND]) if row.get(BEYOND) else None
        except ValidationError as error:
            raise _refuse(path, line, error) from None
        place = places.get((azimuth, height))
        if place is not None:
            turns = "" if row["whole turns"] == "none" else row["whole turns"]
            yield name_known(Task(place, (k1, k2), row["representation"]), turns, cost), certificate, beyond


def _read_certificate(row: Mapping[str, str]) -> Certificate:
    return _CERTIFICATE.validate_python(
        {
            **{name: row[name] for name in ("stationarity", "gradient", "violation", "complementarity")},
            "active": row["active bounds"],
            "is_minimum": row["second order"],
        }
    )


def _list_rows(path: Path, text: str, columns: tuple[str, ...]) -> Iterator[tuple[int, dict[str, str]]]:
    reader = csv.DictReader(io.StringIO(text, newline=""), restval="")
    missing = [name for name in columns if name not in (reader.fieldnames or ())]
    if missing:
        finding = f"the table has no column {', '.join(missing)}"
        raise InputError([Fault(str(path), 1, "", finding, "give a folder that --page of this version wrote")])
    for row in reader:
        yield reader.line_num, {str(name): value for name, value in row.items() if isinstance(value, str)}


def _refuse(path: Path, line: int, error: ValidationError) -> InputError:
    faults = [
        Fault(str(path), line, ".".join(map(str, found["loc"])), found["msg"], "give the file as --page wrote it")
        for found in error.errors()
    ]
    return InputError(faults)
