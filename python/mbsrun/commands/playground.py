"""`mbsrun playground`: a model -> a page that computes with its C, compiled to WebAssembly."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from mbsgen.help import ModelCommand
from mbsrun.commands.console import read_numbers, say
from mbsrun.commands.robots import accept_robots
from mbsrun.external import load
from mbsrun.kernel import Kernels
from mbsrun.linearisation import balance, find_pose, linearise
from mbsrun.models import Extent
from mbsrun.playground.machine import FUNCTIONS, LOOPED, OPTIONAL, describe_controller, describe_regulator
from mbsrun.playground.page import write_playground
from mbsrun.smoothness import demand_smooth

PLAYGROUND_HELP = """Write one HTML page on which MODEL moves, computed by its own C in WebAssembly.

\b
  mbsrun playground models/cart_pole.yaml -o cart_pole.html
  mbsrun playground models/cart_pole.yaml --pose pole=pi --regulate 0.1

The page needs no server and no network. Sliders move joints, and set velocities, accelerations and inputs; tables show
inverse and forward dynamics in all formulations, the mass matrix, energies, and what each function costs. The motion is
simulated on the page. With --controller, a controller that `mbsrun controller` wrote runs there, too; with --regulate,
linear feedback about the pose of --pose, as `mbsrun linearise` finds it.

Zig compiles the C (pip install '.[compiler]'). Loops are kept closed; driven joints move with the
accelerations of their sliders.

\b
Exit codes
  0   written
  2   the model or an argument cannot be accepted; nothing written
"""


@click.command(
    "playground",
    cls=ModelCommand,
    help=PLAYGROUND_HELP,
)
@click.argument("model", type=click.Path(path_type=Path))
@click.option(
    "--controller",
    "folders",
    multiple=True,
    type=click.Path(path_type=Path),
    help="A folder of `mbsrun controller`, of the same model; repeatable.",
)
@click.option("--pose", "poses", multiple=True, metavar="NAME=NUMBER", help="A coordinate of the regulated pose.")
@click.option(
    "--regulate",
    "weight",
    type=click.FloatRange(0, 1e12, min_open=True),
    metavar="W",
    help="Add the feedback that minimises the integral of |x|² + |ẋ|² + W |u|².",
)
@click.option("-o", "--output", "out", type=click.Path(path_type=Path), help="The file; by default NAME.html.")
@accept_robots
def playground_command(
    model: Path, folders: Sequence[Path], poses: Sequence[str], weight: float | None, out: Path | None
) -> None:
    """Generate, compile, write."""
    if poses and weight is None:
        raise click.UsageError("--pose is the pose of --regulate; give both")
    optional = (*OPTIONAL, *LOOPED, "loop_jacobian", *(() if weight is None else ("sensors",)))
    kernels = load(model, extent=Extent(FUNCTIONS, 0 if weight is None else 1, optional=optional))
    demand_smooth(kernels.manifest, "a playground", stops=True)
    controllers = [describe_controller(folder, kernels.manifest) for folder in folders]
    if weight is not None:
        controllers.append(_regulate(kernels, poses, weight))
    out = out or Path(f"{model.stem}.html")
    write_playground(out, kernels, controllers)
    say(f"wrote {out}")


def _regulate(kernels: Kernels, poses: Sequence[str], weight: float) -> dict[str, Any]:
    pose = find_pose(kernels, read_numbers(poses, kernels.manifest.positions, "--pose"))
    return describe_regulator(kernels.manifest, linearise(kernels, balance(kernels, pose, {})), weight)
