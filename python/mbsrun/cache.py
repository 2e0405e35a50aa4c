"""The user's cache: what is made once and found again, by names that tell its content.

    models/<hash>/                  folders that mbsgen generated of model files
    compiled/<model>/<name>-<hash>  objects and libraries
    building-*/                     what is being made, or was when its process was killed

Everything is made aside and renamed into place: it is there as a whole or not at all, whoever else makes the same, and
whenever a process is killed. The time stamp of an entry tells when it was last used.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from mbsgen import manifest as manifests
from mbsgen.errors import MbsError

MODELS, COMPILED, BUILDING = "models", "compiled", "building-"
ABANDONED = 86400.0  # s; what is under way that long was left behind by a killed process
_LOCK = ".lock"

Kind = Literal["generated", "object", "library", "unfinished"]


class CacheError(MbsError):
    """A cache that cannot be written."""


@dataclass(frozen=True)
class Entry:
    """Something in the cache."""

    path: Path
    kind: Kind
    model: str  # the prefix of its C names; empty where it is not known
    size: int  # bytes
    used: float  # when it was last used, s since the epoch

    def is_being_made(self, now: float) -> bool:
        """Tell whether a process may be at work on it."""
        return self.kind == "unfinished" and now - self.used <= ABANDONED


def cache_folder(environment: Mapping[str, str]) -> Path:
    """Tell where the cache is: $XDG_CACHE_HOME/mbsgen, else ~/.cache/mbsgen."""
    base = Path(environment.get("XDG_CACHE_HOME", ""))
    return (base if base.is_absolute() else Path.home() / ".cache") / "mbsgen"


def find_or_make(target: Path, make: Callable[[Path], Path]) -> Path:
    """Give `target`, a path of the cache; what is not there yet, `make` makes in the empty folder that it is given.

    One of several processes that want the same makes it, and the others wait. Raises CacheError if the cache cannot be
    written; what `make` raises passes, and nothing is left.
    """
    if _use(target):
        return target
    cache = cache_folder(os.environ)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with _turn(target):
            if not _use(target):
                _sweep(cache)
                with tempfile.TemporaryDirectory(prefix=BUILDING, dir=cache) as place:
                    _rename(make(Path(place)), target)
    except OSError as error:
        raise CacheError(f"cannot write to the cache {cache}: {error}; set XDG_CACHE_HOME") from None
    return target


def list_entries(cache: Path) -> tuple[Entry, ...]:
    """List what the cache holds, by path."""
    kinds: dict[str, Kind] = {".o": "object", ".so": "library"}
    compiled = [
        _describe(path, kinds[path.suffix], path.parent.name)
        for path in cache.glob(f"{COMPILED}/*/*")
        if path.suffix in kinds
    ]
    generated = [
        _describe(path, "generated", _read_prefix(path)) for path in cache.glob(f"{MODELS}/*") if path.is_dir()
    ]
    rest = [_describe(path, "unfinished", "") for path in (*cache.glob(f"{BUILDING}*"), *cache.rglob(f"*{_LOCK}"))]
    return tuple(sorted((e for e in (*compiled, *generated, *rest) if e), key=lambda e: e.path))


def remove(entries: Iterable[Entry]) -> None:
    """Remove entries; what is gone already is no error. Raises CacheError for what cannot be removed."""
    try:
        for entry in entries:
            if entry.path.is_dir():
                aside = Path(tempfile.mkdtemp(prefix=BUILDING, dir=cache_folder(os.environ)))
                with suppress(FileNotFoundError):
                    entry.path.rename(aside / "removed")  # a folder of which a part is gone is never met
                shutil.rmtree(aside, ignore_errors=True)
            else:
                entry.path.unlink(missing_ok=True)
    except OSError as error:
        raise CacheError(f"cannot remove {entry.path}: {error.strerror}") from None


def _use(target: Path) -> bool:
    """Tell whether an entry is there, and mark it as used."""
    try:
        os.utime(target)
    except FileNotFoundError:
        return False
    except OSError:  # a cache that can only be read
        return target.exists()
    return True


@contextmanager
def _turn(target: Path) -> Iterator[None]:
    """Wait until no other process makes `target`. This saves work; nothing breaks where locks are not kept."""
    place = target.with_name(target.name + _LOCK)
    with place.open("a") as file:
        with suppress(OSError):
            fcntl.flock(file, fcntl.LOCK_EX)
        try:
            yield
        finally:
            place.unlink(missing_ok=True)


def _rename(made: Path, target: Path) -> None:
    try:
        made.replace(target)
    except OSError:
        if not target.is_dir():  # else another process was faster, and made the same folder
            raise


def _sweep(cache: Path) -> None:
    """Remove what killed processes left behind long ago."""
    for place in cache.glob(f"{BUILDING}*"):
        with suppress(OSError):
            if time.time() - place.stat().st_mtime > ABANDONED:
                shutil.rmtree(place, ignore_errors=True)


def _describe(path: Path, kind: Kind, model: str) -> Entry | None:
    """Describe an entry; None where it has just gone."""
    try:
        files = [path, *path.rglob("*")] if path.is_dir() else [path]
        return Entry(path, kind, model, sum(f.stat().st_size for f in files if f.is_file()), path.stat().st_mtime)
    except FileNotFoundError:
        return None


def _read_prefix(folder: Path) -> str:
    try:
        return manifests.read(folder / manifests.FILE_NAME).prefix
    except (MbsError, OSError):
        return ""
