"""Model file -> generated folder in the user's cache; the one place where the solving side calls mbsgen.

A folder is found again by the bytes of the model file and of mbsgen, so a stale one is never met.
"""

from __future__ import annotations

import hashlib
import os
from functools import cache
from pathlib import Path

from mbsgen import resources
from mbsrun.cache import MODELS, cache_folder, find_or_make


def find_folder(path: Path) -> Path:
    """Give the generated folder at `path`; for a model file, one in the cache, which mbsgen makes if it is new.

    Raises InputError with every fault of the model, CacheError if the cache cannot be written.
    """
    if not (path.is_file() or path.suffix in (".yaml", ".yml")):
        return path

    def make(building: Path) -> Path:
        from mbsgen.pipeline import generate  # here alone, and late: kernels are called without SymPy

        generate(path, building / "generated")
        if fingerprint(path) != name:
            raise _ChangedError
        return building / "generated"

    while True:
        name = fingerprint(path)
        try:
            return find_or_make(cache_folder(os.environ) / MODELS / name, make)
        except _ChangedError:
            continue


class _ChangedError(Exception):
    """A model file that was changed while it was generated from."""


def fingerprint(model: Path) -> str:
    """Name what mbsgen makes of a model file."""
    try:
        text = model.read_bytes()
    except OSError:  # which mbsgen tells better
        text = b""
    return hashlib.sha256(_fingerprint_generator() + text).hexdigest()[:40]


@cache
def _fingerprint_generator() -> bytes:
    """Hash the files that generation depends on."""
    digest = hashlib.sha256()
    for folder in (Path(resources.__file__).parent, resources.folder("templates"), resources.folder("csrc")):
        for file in sorted(folder.rglob("*.*")):
            if file.is_file() and file.suffix != ".pyc":
                digest.update(hashlib.sha256(str(file.relative_to(folder)).encode()).digest())
                digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.digest()
