"""Model file -> generated folder in the user's cache; the one place where the solving side calls mbsgen.

A folder is found again by the bytes of the model file and of mbsgen, so a stale one is never met.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path, PurePath

from mbsgen import resources
from mbsrun.cache import MODELS, find_or_make


@dataclass(frozen=True)
class Extent:
    """What is generated of a model file."""

    functions: tuple[str, ...] | None = None  # None: all
    derivatives: int = 2
    python: bool = False  # the equations as a Python module, too
    scene: Path | None = None  # a scene file: what is wanted of the model
    without: tuple[str, ...] = ()  # reductions of the operation count that are switched off, by their fields' names


WHOLE = Extent()


def is_model(path: Path) -> bool:
    """Test whether a path is that of a model file, in any format; else it is that of a generated folder."""
    return path.is_file() or (bool(path.suffix) and not path.is_dir())


def find_folder(path: Path, extent: Extent = WHOLE) -> Path:
    """Give the generated folder at `path`; for a model file, one in the cache, which mbsgen makes if it is new.

    A folder that is given holds what it holds. Raises InputError with every fault of the model, OptionError for
    functions that it does not have, CacheError if the cache cannot be written.
    """
    if not is_model(path):
        return path

    def make(building: Path) -> Path:
        from mbsgen.pipeline import Options, generate  # here alone, and late: kernels are called without SymPy

        options = Options(functions=extent.functions, derivatives=extent.derivatives, python=extent.python)
        reductions = replace(options.reductions, **dict.fromkeys(extent.without, False))
        options = replace(options, reductions=reductions, scene=extent.scene or options.scene)
        generate(path, building / "generated", options)
        if fingerprint(path, extent) != name:
            raise _ChangedError
        return building / "generated"

    while True:
        name = fingerprint(path, extent)
        try:
            return find_or_make(PurePath(MODELS, name), make)
        except _ChangedError:
            continue


class _ChangedError(Exception):
    """A model file that was changed while it was generated from."""


def fingerprint(model: Path, extent: Extent = WHOLE) -> str:
    """Name what mbsgen makes of a model file."""
    told = b"" if extent == WHOLE else repr(extent).encode()
    texts = [_read(file) for file in (extent.scene, model) if file is not None]
    return hashlib.sha256(fingerprint_generator() + told + b"".join(texts)).hexdigest()[:40]


def _read(file: Path) -> bytes:
    try:
        return file.read_bytes()
    except OSError:  # which mbsgen tells better
        return b""


@cache
def fingerprint_generator() -> bytes:
    """Hash the files that generation depends on."""
    digest = hashlib.sha256()
    for folder in (Path(resources.__file__).parent, resources.folder("templates"), resources.folder("csrc")):
        for file in sorted(folder.rglob("*.*")):
            if file.is_file() and file.suffix != ".pyc":
                digest.update(hashlib.sha256(str(file.relative_to(folder)).encode()).digest())
                digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.digest()
