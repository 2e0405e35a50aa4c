"""The user's cache: files that are made once and found again, by names made from their content.

    models/<hash>/                  folders that mbsgen generated from model files
    compiled/<model>/<name>-<hash>  objects, libraries and call graphs; in compiled/mbs, objects for every model, and
                                    declarations of C as cffi reads them
    <entry>.sha256                  the hash of an entry's content, checked at each use
    building-*/                     entries in the making, or left by a killed process

Everything is made aside and renamed into place: it is complete or absent, even if another process makes the same or is
killed. The time stamp of an entry is the time of its last use.

Libraries of the cache run in this process. So a cache that somebody else may write to is not used, and an entry that
does not match its hash is made again. Without a cache, entries are made in a temporary folder, for the life of the
process.
"""

from __future__ import annotations

import atexit
import logging
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path, PurePath
from threading import Lock
from typing import Literal

from mbsgen import manifest as manifests
from mbsgen.errors import MbsError
from mbsrun.trust import StrangerError, check_folder, close_to_others, compute_hash, make_folder, read_checked

if sys.platform != "win32":
    import fcntl
    import pwd

MODELS, COMPILED, BUILDING = "models", "compiled", "building-"
HASH, DECLARED = ".sha256", ".cdef"
ABANDONED = 86400.0  # s; older unfinished entries were left by a killed process
ROOM = 16_000_000  # bytes; with less free space, a failure to compile may be a full disk
_LOCK = ".lock"
_LOG = logging.getLogger("mbsrun")

Kind = Literal["generated", "object", "library", "unfinished"]


class CacheError(MbsError):
    """A cache that cannot be used."""


@dataclass(frozen=True)
class Entry:
    """One entry of the cache."""

    path: Path
    kind: Kind
    model: str  # the prefix of its C names; empty if unknown
    size: int  # bytes
    used: float  # time of the last use, s since the epoch

    def is_being_made(self, now: float) -> bool:
        """Return whether a process may still be making it."""
        return self.kind == "unfinished" and now - self.used <= ABANDONED


def cache_folder(environment: Mapping[str, str]) -> Path:
    """Return the cache's path: $XDG_CACHE_HOME/mbsgen, else ~/.cache/mbsgen; of Windows, in %LOCALAPPDATA%.

    Raises CacheError without such a folder.
    """
    base = Path(environment.get("XDG_CACHE_HOME", ""))
    if base.is_absolute():
        return base / "mbsgen"
    home = _find_home(environment)
    if home is None:
        raise CacheError("there is no home folder to keep a cache in; set HOME or XDG_CACHE_HOME")
    return home / ".cache" / "mbsgen"


def find_or_make(name: PurePath, make: Callable[[Path], Path]) -> Path:
    """Return the entry `name` of the cache; `make` makes a missing entry in the empty folder it is given.

    If several processes need the same entry, one makes it, and the others wait. Where the cache cannot be used, one
    message is logged, and the entry is made in a temporary folder. Raises CacheError if that cannot be used either. An
    exception of `make` passes, and nothing is left.
    """
    try:
        return _find_or_make(cache_folder(os.environ), name, make)
    except CacheError as error:
        _warn_once(f"{error}; a temporary folder replaces it until the process ends")
    return _find_or_make(_open_temporary(), name, make)


def list_entries(cache: Path) -> tuple[Entry, ...]:
    """List the entries of a cache, by path."""
    kinds: dict[str, Kind] = {
        ".o": "object",
        ".ci": "object",
        DECLARED: "object",
        ".so": "library",
        ".wasm": "library",
        ".cubin": "library",
    }
    compiled = [
        _describe(path, kinds[path.suffix], path.parent.name)
        for path in cache.glob(f"{COMPILED}/*/*")
        if path.suffix in kinds
    ]
    generated = [
        _describe(path, "generated", _read_prefix(path)) for path in cache.glob(f"{MODELS}/*") if path.is_dir()
    ]
    hashes = [path for path in cache.rglob(f"*{HASH}") if not path.with_suffix("").exists()]
    rest = [
        _describe(path, "unfinished", "")
        for path in (*cache.glob(f"{BUILDING}*"), *cache.rglob(f"*{_LOCK}"), *hashes)
        if not path.parent.name.startswith(BUILDING)
    ]
    return tuple(sorted((e for e in (*compiled, *generated, *rest) if e), key=lambda e: e.path))


def remove(entries: Iterable[Entry]) -> None:
    """Remove entries; missing ones are no error. Raises CacheError if one cannot be removed."""
    try:
        for entry in entries:
            if entry.path.is_dir():
                aside = Path(tempfile.mkdtemp(prefix=BUILDING, dir=cache_folder(os.environ)))
                with suppress(FileNotFoundError):
                    entry.path.rename(aside / "removed")  # so nobody meets a folder of which a part is gone
                shutil.rmtree(aside, ignore_errors=True)
            else:
                entry.path.unlink(missing_ok=True)
            _hash_of(entry.path).unlink(missing_ok=True)
    except OSError as error:
        raise CacheError(f"cannot remove {entry.path}: {error.strerror}") from None


# --- paths ---------------------------------------------------------------------------------------------------------


def _find_home(environment: Mapping[str, str]) -> Path | None:
    """Return the user's home: $HOME, else by the user's number; None where it does not exist."""
    if sys.platform == "win32":
        home = Path(environment.get("LOCALAPPDATA", ""))
    else:
        try:
            home = Path(environment.get("HOME") or pwd.getpwuid(os.geteuid()).pw_dir)
        except KeyError:
            return None
    return home if home.is_absolute() and home.is_dir() else None


_TEMPORARY: dict[int, Path] = {}  # by the number of the process: after a fork there are two
_ONE = Lock()


def _open_temporary() -> Path:
    """Return a folder of this process alone, removed when it ends."""
    process = os.getpid()
    with _ONE:
        if process not in _TEMPORARY:
            try:
                _TEMPORARY[process] = Path(tempfile.mkdtemp(prefix="mbsgen-")).resolve()
            except OSError as error:
                raise CacheError(f"cannot make a temporary folder: {error.strerror or error}; set TMPDIR") from None
            atexit.register(_remove_temporary, process)
        return _TEMPORARY[process]


def _remove_temporary(process: int) -> None:
    if os.getpid() == process:
        shutil.rmtree(_TEMPORARY[process], ignore_errors=True)


@cache
def _warn_once(sentence: str) -> None:
    _LOG.warning("%s", sentence)


# --- entries -------------------------------------------------------------------------------------------------------


def _find_or_make(cache: Path, name: PurePath, make: Callable[[Path], Path]) -> Path:
    """Find or make an entry of this cache. Raises CacheError where it cannot be trusted or written."""
    try:
        target = _open_folder(cache, name.parent) / name.name
        if not _use(target):
            with _turn(target):
                if not _use(target):
                    _sweep(cache)
                    _make(target.parents[len(name.parents) - 1], target, make)
    except OSError as error:
        raise CacheError(f"cannot write to the cache {cache}: {error.strerror or error}; set XDG_CACHE_HOME") from None
    except StrangerError as error:
        raise CacheError(f"the cache {cache} cannot be trusted: {error}") from None
    return target


def _open_folder(cache: Path, name: PurePath) -> Path:
    """Make missing folders of the cache, and check that they belong to the user; return the path without links."""
    make_folder(cache / name)
    place, top, home = (cache / name).resolve(), cache.resolve(), _find_home(os.environ)
    check_folder(place, top, None if home is None else home.resolve())
    return place


def _use(target: Path) -> bool:
    """Return whether an entry matches its hash, and mark it as used."""
    try:
        is_whole = compute_hash(target) == read_checked(_hash_of(target)).decode(errors="replace").strip()
    except (OSError, StrangerError):
        return False
    with suppress(OSError):  # a cache that can only be read
        os.utime(target)
    return is_whole


def _make(cache: Path, target: Path, make: Callable[[Path], Path]) -> None:
    """Make an entry and its hash aside, and rename them into place, also over an entry that does not match."""
    with tempfile.TemporaryDirectory(prefix=BUILDING, dir=cache) as place:
        try:
            made = make(Path(place))
        except MbsError:
            _check_room(Path(place))
            raise
        close_to_others(made)
        record = Path(place) / HASH
        record.touch(mode=0o600)
        record.write_text(compute_hash(made) + "\n", encoding="ascii")
        if os.path.lexists(target) and not _use(target):  # else another process was faster, and made the same
            if os.path.lexists(_hash_of(target)):
                _LOG.warning("%s has changed since it was made; it is made again", target)
            target.rename(Path(place) / "replaced")
        record.replace(_hash_of(target))
        _rename(made, target)


def _check_room(place: Path) -> None:
    """Raise OSError if the disk is full, since a compiler reports this only in its own words."""
    with (place / "room").open("wb") as file:
        if sys.platform == "linux":
            os.posix_fallocate(file.fileno(), 0, ROOM)
        else:
            file.write(bytes(ROOM))


def _hash_of(target: Path) -> Path:
    return target.with_name(target.name + HASH)


@contextmanager
def _turn(target: Path) -> Iterator[None]:
    """Wait until no other process makes `target`. This saves work; nothing breaks where locks are not kept."""
    place = target.with_name(target.name + _LOCK)
    with place.open("a") as file:
        with suppress(OSError):
            if sys.platform != "win32":
                fcntl.flock(file, fcntl.LOCK_EX)
        try:
            yield
        finally:
            with suppress(PermissionError):  # of Windows, while another process waits with the file open
                place.unlink(missing_ok=True)


def _rename(made: Path, target: Path) -> None:
    try:
        made.replace(target)
    except OSError:
        if not target.is_dir():  # else another process was faster, and made the same folder
            raise


def _sweep(cache: Path) -> None:
    """Remove old remains of killed processes."""
    for place in cache.glob(f"{BUILDING}*"):
        with suppress(OSError):
            if time.time() - place.stat().st_mtime > ABANDONED:
                shutil.rmtree(place, ignore_errors=True)


def _describe(path: Path, kind: Kind, model: str) -> Entry | None:
    """Return the description of an entry; None if it has just been removed."""
    try:
        files = [path, *path.rglob("*")] if path.is_dir() else [path]
        sizes = sum(f.stat().st_size for f in (*files, _hash_of(path)) if f.is_file())
        return Entry(path, kind, model, sizes, path.stat().st_mtime)
    except FileNotFoundError:
        return None


def _read_prefix(folder: Path) -> str:
    try:
        return manifests.read(folder / manifests.FILE_NAME).prefix
    except (MbsError, OSError):
        return ""
