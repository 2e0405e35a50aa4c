"""Published robots with floating bases, imported from the package that carries their files."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from mbsgen.importing import Choices, import_model
from mbsgen.model.model import FREE, Body, Fixed, Joint, Model
from mbsgen.model.writer import write_model

ROBOTS: Mapping[str, str] = {
    "anymal": "anymal_b_simple_description/robots/anymal.urdf",
    "talos": "talos_data/robots/talos_reduced.urdf",
}
FOLDER = "cmeel.prefix/share/example-robot-data/robots"  # where the package example-robot-data puts them


def find_file(name: str) -> Path | None:
    """Return a robot's URDF; None where it is not there."""
    files = (Path(entry) / FOLDER / ROBOTS[name] for entry in sys.path)
    return next((file for file in files if file.is_file()), None)


def find_robot(name: str, folder: Path) -> Path | None:
    """Write a robot's model file, its base on six joints, without damping and friction; None where it is not there."""
    file = find_file(name)
    if file is None:
        return None
    imported = import_model(file, Choices(name=name, base="floating", mimic="free"))
    path = folder / f"{name}.yaml"
    path.write_text(write_model(remove_forces(imported.model)), encoding="utf-8")
    return path


def remove_forces(model: Model) -> Model:
    """Return the model without laws of joints."""

    def release(body: Body) -> Body:
        match body.joint:
            case Fixed():
                return body
            case Joint():
                return replace(body, joint=replace(body.joint, law=FREE))
        return replace(body, joint=tuple(replace(joint, law=FREE) for joint in body.joints))

    return replace(model, bodies=tuple(map(release, model.bodies)))
