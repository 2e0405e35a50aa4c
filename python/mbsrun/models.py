"""Model file -> generated folder in the user's cache; the only place where the solving side calls mbsgen.

A folder is found again by the bytes of the model file and of mbsgen, so a stale one is never found.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from html import unescape
from pathlib import Path, PurePath
from typing import Any

from mbsgen import resources
from mbsgen.quick_classes import quick_data_classes
from mbsgen.quick_imports import without_searches
from mbsrun.cache import MODELS, find_or_make

INCLUSION = re.compile(rb"""<include\s[^>]*?\bfile\s*=\s*["']([^"']*)""")  # of MJCF
MESH = re.compile(rb"""<mesh\s[^>]*?\bfile\s*=\s*["']([^"']*)""")  # of MJCF, whose inertia counts
TYRE = re.compile(rb"""\bfile["']?\s*:\s*["']?([^"'\s,}]+\.tir)""", re.IGNORECASE)  # of a model file
MESHES = re.compile(rb"""\b(?:meshdir|assetdir)\s*=\s*["']([^"']*)""")
MOST_INCLUDED = 1000


@dataclass(frozen=True)
class Extent:
    """The part to generate from a model file."""

    functions: tuple[str, ...] | None = None  # None: all
    derivatives: int = 2
    targets: tuple[str, ...] = ()  # languages beside C, such as python
    scene: Path | None = None  # a scene file
    without: tuple[str, ...] = ()  # reductions of the operation count that are switched off, by their fields' names
    runtime: bool = False  # every number of the model a run-time parameter, by its path in the file
    optional: tuple[str, ...] = ()  # functions beside the named ones, if the model has them: of loops, of sensors
    values: tuple[str, ...] = ()  # functions among these that are written without derivatives
    counted: bool = False  # the operations of the formulations in the report, which takes as long as the functions
    compared: bool = False  # the operations of derivatives in the report in all ways, which takes longer still
    opened: bool = False  # the forces of rigid stops, dry friction and rigid points are inputs


WHOLE = Extent()
# Simulations need no second derivatives, and no derivatives of accelerations, which take longest to write.
INTEGRATED = Extent(derivatives=1, values=("exp1", "exp2"))


def is_model(path: Path) -> bool:
    """Return whether a path is a model file's, in any format, and not a generated folder's."""
    return path.is_file() or (bool(path.suffix) and not path.is_dir())


def find_folder(path: Path, extent: Extent = WHOLE) -> Path:
    """Return the generated folder at `path`; for a model file, a folder in the cache, which mbsgen makes if it is new.

    A given folder is used as it is. Raises InputError with every fault of the model, OptionError for functions that it
    does not have, CacheError if the cache cannot be written.
    """
    if not is_model(path):
        return path

    def make(building: Path) -> Path:
        with quick_data_classes(), without_searches():
            from mbsgen.pipeline import generate  # only here, and late: kernels are called without SymPy

        generate(path, building / "generated", _make_options(extent))
        if fingerprint(path, extent) != name:
            raise _ChangedError
        return building / "generated"

    while True:
        name = fingerprint(path, extent)
        try:
            return find_or_make(PurePath(MODELS, name), make)
        except _ChangedError:
            continue


def _make_options(extent: Extent) -> Any:
    """Return the generator's options for an extent."""
    from mbsgen.pipeline import Options

    options = Options(
        runtime=extent.runtime,
        functions=extent.functions,
        optional=extent.optional,
        values=extent.values,
        derivatives=extent.derivatives,
        targets=extent.targets,
        count=extent.counted,
        compare=extent.compared,
        opened=extent.opened,
    )
    reductions = replace(options.reductions, **dict.fromkeys(extent.without, False))
    return replace(options, reductions=reductions, scene=extent.scene or options.scene)


def derive_equations(path: Path, extent: Extent, parameters: Mapping[str, float], *, numbers: bool) -> tuple[Any, str]:
    """Derive an `mbsgen.equations.Motion` of a model file with these parameters, and the mechanism's hash.

    numbers: only parameters of the run time are symbols, else all of them. Raises InputError with every fault of the
    model, SizeError for equations that are too long.
    """
    from mbsgen.pipeline import derive_equations

    return derive_equations(path, _make_options(extent), parameters, numbers=numbers)


def read_numbers(path: Path, parameters: Mapping[str, float]) -> Any:
    """Read the inertias, frictions and rotors of a model file: an `mbsgen.renumbering.Numbers`.

    `parameters` replace the model's. Raises InputError with every fault of the file.
    """
    from mbsgen.pipeline import read_numbers

    return read_numbers(path, parameters)


def change_numbers(path: Path, remarks: Sequence[str], **changes: Mapping[str, Any]) -> str:
    """Write a model file with other numbers, the fields of `mbsgen.renumbering.Changes`, after remarks as comments.

    Raises InputError where the changed model is none.
    """
    from mbsgen.pipeline import Changes, change_numbers

    return change_numbers(path, Changes(**changes), remarks)


def import_robot(path: Path, choices: Mapping[str, Any]) -> tuple[Path, tuple[str, ...]]:
    """Import a robot's file; return the path of its model file in the cache, which has its stem, and warnings.

    `choices` are fields of `mbsgen.importing.Choices`. A hash of the model file names the entry. Raises InputError
    with every fault of the robot's file, OptionError for any other file, CacheError if the cache cannot be written.
    """
    from mbsgen.pipeline import convert

    text, warnings = convert(path, choices)
    written, file = text.encode(), f"{path.stem}.yaml"

    def make(building: Path) -> Path:
        folder = building / "imported"
        folder.mkdir()
        (folder / file).write_bytes(written)
        return folder

    name = hashlib.sha256(os.fsencode(file) + b"\0" + written).hexdigest()[:40]
    return find_or_make(PurePath(MODELS, name), make) / file, warnings


def read_subject(path: Path) -> Any:
    """Read settings of a scaling: an `mbsgen.subjects.settings.Subject`. Raises InputError with every fault."""
    from mbsgen.pipeline import read_subject

    return read_subject(path)


def scale_subject(subject: Any, distances: Mapping[tuple[str, str], float]) -> Any:
    """Scale the model of settings by measured distances of pairs of markers [m].

    Return an `mbsgen.subjects.scaling.Scaled`. Raises InputError with every fault.
    """
    from mbsgen.pipeline import scale_subject

    return scale_subject(subject, distances)


def place_markers(subject: Any, scaled: Any, joints: Mapping[str, float], places: Mapping[str, Any]) -> Any:
    """Move markers of a scaled model to places in the base, (3,) [m], at a pose of joints."""
    from mbsgen.pipeline import place_markers

    return place_markers(subject, scaled, joints, places)


def list_undrawn(path: Path) -> tuple[str, ...]:
    """List the shapes of a robot's file that pictures lack; none for any other path."""
    if not path.is_file():
        return ()
    from mbsgen.pipeline import list_undrawn

    return list_undrawn(path)


class _ChangedError(Exception):
    """A model file that changed during generation."""


def fingerprint(model: Path, extent: Extent = WHOLE) -> str:
    """Return a hash of a model file with the files that it includes, the scene and the generator."""
    told = b"" if extent == WHOLE else repr(extent).encode()
    scene = b"" if extent.scene is None else _read(extent.scene)
    texts = [scene, *_read_all(model)]
    return hashlib.sha256(fingerprint_generator() + told + b"".join(texts)).hexdigest()[:40]


def _read_all(model: Path) -> list[bytes]:
    """Read a model, and the files of its folder that it includes or takes meshes or tyres from."""
    folder, files, texts = model.resolve().parent, [model], []
    for file in files:  # which grows
        texts.append(_read(file))
        names = [unescape(name.decode(errors="replace")) for name in INCLUSION.findall(texts[-1])]
        files += dict.fromkeys(
            path for name in names if _is_inside(path := folder / name, folder) and path not in files
        )
        if len(files) > MOST_INCLUDED:  # mbsgen refuses it
            break
    tyres = sorted({folder / name.decode(errors="replace") for text in texts for name in TYRE.findall(text)})
    return [*texts, *map(_read, _list_meshes(folder, texts)), *(_read(x) for x in tyres if _is_inside(x, folder))]


def _list_meshes(folder: Path, texts: Sequence[bytes]) -> list[Path]:
    """List the files in a folder that texts of MJCF name as meshes."""

    def find(pattern: re.Pattern[bytes]) -> list[str]:
        return sorted({unescape(name.decode(errors="replace")) for text in texts for name in pattern.findall(text)})

    names = find(MESH)
    names += sorted({PurePath(name).name for name in names} - {*names})  # for `strippath`
    paths = (folder / place / name for name in names for place in ("", *find(MESHES)))
    return [path for path in paths if _is_inside(path, folder)]


def _is_inside(path: Path, folder: Path) -> bool:
    try:
        return path.resolve().is_relative_to(folder) and path.is_file()
    except (OSError, ValueError, RuntimeError):  # mbsgen reports it
        return False


def _read(file: Path) -> bytes:
    try:
        return file.read_bytes()
    except OSError:  # mbsgen reports it with a better message
        return b""


@cache
def fingerprint_generator() -> bytes:
    """Return a hash of the files that generation depends on."""
    digest = hashlib.sha256()
    for folder in (Path(resources.__file__).parent, resources.folder("templates"), resources.folder("csrc")):
        found = (os.path.join(place, name) for place, _, names in os.walk(folder) for name in names if "." in name)
        for file in sorted(file for file in found if not file.endswith(".pyc")):
            digest.update(hashlib.sha256(os.path.relpath(file, folder).encode()).digest())
            with open(file, "rb") as text:
                digest.update(hashlib.sha256(text.read()).digest())
    return digest.digest()
