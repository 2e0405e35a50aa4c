"""Files that only this user, or root, can have written: owners, permissions, and hashes of contents.

If nobody else may write to a folder and the folders above it, nobody else can replace its files between a check and
their use. So folders are checked up to the user's home, or to the root of the file system. Files are opened first; then
the open file is checked and read. Windows has neither owners nor permissions of this kind; there the profile's own
access list has to keep others out, and nothing but hashes is checked.
"""

from __future__ import annotations

import hashlib
import os
import stat
import sys
from collections.abc import Iterator
from pathlib import Path

BYTECODE = "__pycache__"  # Python writes it beside a module that it imports
OTHERS = 0 if sys.platform == "win32" else stat.S_IWGRP | stat.S_IWOTH
if sys.platform == "win32":
    _OPENING = os.O_RDONLY | os.O_BINARY
else:
    _OPENING = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC


class StrangerError(Exception):
    """A file or folder that somebody else may have written."""


def make_folder(folder: Path) -> None:
    """Make a folder, and missing ones above it, for this user alone."""
    for part in (*reversed(folder.parents), folder):
        if not part.is_dir():
            part.mkdir(mode=0o700, exist_ok=True)


def check_folder(folder: Path, top: Path, home: Path | None) -> None:
    """Check a folder in `top` and all folders above it, up to `home` if it lies there; paths without links.

    Above `top`, a folder open to all is accepted if it is sticky: there only owners can replace entries. Raises
    StrangerError with the reason.
    """
    for part in (folder, *folder.parents):
        status = part.lstat()
        _check_owner(part, status)
        is_sticky = part in top.parents and status.st_mode & stat.S_ISVTX
        if status.st_mode & OTHERS and not is_sticky:
            raise StrangerError(f"others may write to {part} (chmod go-w forbids it)")
        if part == home:
            return


def close_to_others(path: Path) -> None:
    """Forbid others to write to a file, or to a folder and all its contents."""
    for part in [path, *path.rglob("*")] if path.is_dir() else [path]:
        part.chmod(part.stat().st_mode & 0o777 & ~OTHERS)


def compute_hash(path: Path) -> str:
    """Return the SHA-256 of a file, or of the names and contents in a folder.

    Raises StrangerError where somebody else may have written it, OSError where it cannot be read.
    """
    if not stat.S_ISDIR(path.lstat().st_mode):
        return hashlib.sha256(read_checked(path)).hexdigest()
    digest = hashlib.sha256()
    for part in _walk(path):
        digest.update(f"{part.relative_to(path)}\0{hashlib.sha256(read_checked(part)).hexdigest()}\n".encode())
    return digest.hexdigest()


def read_checked(path: Path) -> bytes:
    """Read a file that nobody else can have written. Raises as `compute_hash` does."""
    descriptor = os.open(path, _OPENING)
    with open(descriptor, "rb") as file:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise StrangerError(f"{path} is no plain file")
        _check_entry(path, status)
        return file.read()


def _walk(folder: Path) -> Iterator[Path]:
    """Yield the files of a folder and its subfolders, in an order that depends on their names alone."""
    _check_entry(folder, folder.lstat())
    for part in sorted(folder.iterdir()):
        if stat.S_ISDIR(part.lstat().st_mode):
            yield from _walk(part) if part.name != BYTECODE else ()
        else:
            yield part


def _check_entry(path: Path, status: os.stat_result) -> None:
    _check_owner(path, status)
    if status.st_mode & OTHERS:
        raise StrangerError(f"others may write to {path}")


def _check_owner(path: Path, status: os.stat_result) -> None:
    if sys.platform != "win32" and status.st_uid not in (os.geteuid(), 0):
        raise StrangerError(f"{path} belongs to another user")
