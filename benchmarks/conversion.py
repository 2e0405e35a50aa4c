"""Convert URDF to a model file: `python -m benchmarks.conversion ROBOT.urdf NAME [--hold JOINT ...]`.

Pinocchio reads the file. Its joint placements and inertias are kept, with two exceptions: an angle of a placement
within 1e-6 of a multiple of a quarter turn becomes that multiple (URDF files round pi/2, so that zeros would become
1e-10), and numbers are rounded to 15 digits, numbers below 1e-12 to 0. `--hold` keeps joints (the fingers of a
gripper) at q = 0; their bodies become part of the carrying body.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import numpy as np
import pinocchio as pin

from mbsgen.model.construction import body, inertia, make_model, revolute
from mbsgen.model.model import Model
from mbsgen.model.writer import write_model

QUARTER = np.pi / 2
QUARTERS: dict[int, float | str] = {-2: "-pi", -1: "-pi/2", 0: 0.0, 1: "pi/2", 2: "pi"}
NEAR_TURN, NEAR_ZERO = 1e-6, 1e-12
AXES = {"JointModelRX": "x", "JointModelRY": "y", "JointModelRZ": "z"}


def read_urdf(path: Path, held: tuple[str, ...] = ()) -> Any:
    """Read a URDF file as Pinocchio's model, with the named joints held at 0."""
    model = pin.buildModelFromUrdf(str(path))
    return pin.buildReducedModel(model, [model.getJointId(name) for name in held], pin.neutral(model))


def convert(source: Any, name: str) -> Model:
    """Make mbsgen's model of a Pinocchio model. Raises ValueError for joints that turn about no coordinate axis."""
    bodies = []
    for j in range(1, source.njoints):
        kind = source.joints[j].shortname()
        if kind not in AXES:
            raise ValueError(f"joint {source.names[j]}: {kind}; only {', '.join(AXES)} are converted")
        place, matter = source.jointPlacements[j], source.inertias[j]
        roll, pitch, yaw = pin.rpy.matrixToRpy(place.rotation)
        turns = [(axis, _angle(angle)) for axis, angle in zip("zyx", (yaw, pitch, roll), strict=True)]
        joint = revolute(
            AXES[kind],
            name=source.names[j],
            position=[_number(x) for x in place.translation],
            orientation=[(axis, angle) for axis, angle in turns if angle != 0.0],
        )
        tensor = matter.inertia
        entries = [_number(tensor[r, c]) for r, c in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
        parent = {"parent": f"link{source.parents[j]}"} if source.parents[j] else {}
        com = [_number(x) for x in matter.lever]
        bodies.append(body(f"link{j}", joint, mass=_number(matter.mass), com=com, inertia=inertia(*entries), **parent))
    return make_model(name, bodies, gravity=[_number(x) for x in source.gravity.linear])


def _angle(angle: float) -> float | str:
    turns = round(angle / QUARTER)
    return _number(angle) if abs(angle - turns * QUARTER) > NEAR_TURN else QUARTERS[turns]


def _number(x: float) -> float:
    return float(f"{x:.15g}") if abs(x) > NEAR_ZERO else 0.0


@click.command()
@click.argument("urdf", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.argument("name")
@click.option("--hold", multiple=True, metavar="JOINT", help="A joint that is held at q = 0.")
def main(urdf: Path, name: str, hold: tuple[str, ...]) -> None:
    """Print the model file of a robot that URDF describes."""
    click.echo(write_model(convert(read_urdf(urdf, hold), name)), nl=False)


if __name__ == "__main__":
    main()
