"""Output on disk: a folder appears complete or not at all, and never replaces files that others wrote."""

from __future__ import annotations

import ctypes
import json
import os
import re
import tempfile
from collections.abc import Mapping
from pathlib import Path

from mbsgen import manifest
from mbsgen.errors import Fault, InputError

_AT_FDCWD, _RENAME_EXCHANGE = -100, 2  # of Linux: <fcntl.h>, <linux/fs.h>
# The files that mbsgen writes for a model with prefix {0}, and files that compilers and Python add to them.
_OWN = (
    r"{0}(_\w+)?\.(c|h|cu|hpp|pc|py|jl|fmu)|mbs_\w+\.(c|h|hpp)|CMakeLists\.txt|manifest\.json|report\.(json|md)"
    r"|matlab|matlab/{0}_\w+\.m|check|\w+\.o|__pycache__|__pycache__/.*"
    r"|rust|rust/(src|tests|target)|rust/Cargo\.(toml|lock)|rust/src/\w+\.rs|rust/src/kernels|rust/src/kernels/\w+\.rs"
    r"|rust/tests/references\.rs|rust/target/.*"
)


def find_differences(files: Mapping[str, str | bytes], out: Path) -> tuple[str, ...]:
    """List the files, by path, that are missing in `out` or differ there; other files there are ignored."""
    return tuple(
        name for name, text in files.items() if not (out / name).is_file() or (out / name).read_bytes() != _encode(text)
    )


def _encode(content: str | bytes) -> bytes:
    return content if isinstance(content, bytes) else content.encode("utf-8")


def write_folder(files: Mapping[str, str | bytes], out: Path) -> None:
    """Write files, path -> content, as a whole folder: it appears complete, in place of an earlier one, or not at all.

    Raises InputError when `out` holds anything that mbsgen did not write, or cannot be written.
    """
    out = check_folder(out)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{out.name}-", dir=out.parent) as aside:
            fresh = Path(aside) / "fresh"
            for name, text in files.items():
                (fresh / name).parent.mkdir(parents=True, exist_ok=True)
                (fresh / name).write_bytes(_encode(text))
            _replace(fresh, out)
    except OSError as error:
        raise _refuse(out, error) from None


def check_folder(out: Path) -> Path:
    """Return the folder that a path leads to. Raises InputError where it must not be replaced."""
    out = Path(os.path.realpath(out))  # a link is followed
    strange = _find_strange(out)
    if strange:
        raise InputError([Fault(str(out), 0, "", strange, "name another folder with -o, or remove this one")])
    return out


def write_file(content: bytes, out: Path) -> None:
    """Write a file. Raises InputError when it cannot be written."""
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_bytes(content)
    except OSError as error:
        raise _refuse(out, error) from None


def _refuse(out: Path, error: OSError) -> InputError:
    """Return the error for a place that cannot be written."""
    finding = f"it cannot be written: {error.strerror}"
    return InputError([Fault(str(out), 0, "", finding, "give another path with -o")])


def _replace(fresh: Path, out: Path) -> None:
    """Put a folder in the place of another; the old folder stays beside `fresh`, or in its place.

    A process that is killed leaves the old folder or the new one, and the hidden folder beside them. Where folders
    cannot be exchanged, there is a moment with neither in place: then the old one is in the hidden folder.
    """
    if not out.exists():
        fresh.rename(out)
    elif not _exchange(fresh, out):
        out.rename(fresh.with_name("old"))
        fresh.rename(out)


def _exchange(one: Path, other: Path) -> bool:
    """Exchange two folders in one step; return whether this succeeded. Only Linux can, on most file systems."""
    try:
        renameat2 = ctypes.CDLL(None).renameat2
    except (AttributeError, TypeError):  # TypeError: of Windows, where None names no library
        return False
    names = os.fsencode(one), os.fsencode(other)
    return bool(renameat2(_AT_FDCWD, names[0], _AT_FDCWD, names[1], _RENAME_EXCHANGE) == 0)


def _find_strange(out: Path) -> str:
    """Return the reason why a path must not be replaced; empty if it may be, or does not exist."""
    if Path.cwd().is_relative_to(out):
        return "it is the folder you are in, and would be replaced by another of its name"
    if not out.exists() or (out.is_dir() and not any(out.iterdir())):
        return ""
    try:
        told = json.loads((out / manifest.FILE_NAME).read_text(encoding="utf-8"))
        if not told["generator"].startswith("mbsgen"):
            raise ValueError
        own = re.compile(_OWN.format(re.escape(told["prefix"])), re.ASCII)
        listed = set(told.get("files", ()))  # a controller's folder has files of its model beside its own
    except (OSError, ValueError, RecursionError, KeyError, TypeError, AttributeError):  # no such file, no such content
        return "it exists, and is no folder that mbsgen wrote"
    names = (path.relative_to(out).as_posix() for path in out.rglob("*"))
    alien = sorted(name for name in names if not own.fullmatch(name) and name not in listed)
    return f"it holds {alien[0]}, which mbsgen did not write" if alien else ""
