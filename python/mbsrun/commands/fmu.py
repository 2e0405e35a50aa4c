"""`mbsrun fmu`: a model -> a functional mock-up unit of FMI 2.0 or 3.0."""

from __future__ import annotations

from pathlib import Path

import click

from mbsgen.help import ModelCommand
from mbsrun.commands.console import say
from mbsrun.commands.robots import accept_robots
from mbsrun.external import load
from mbsrun.fmu import write_fmu
from mbsrun.models import Extent
from mbsrun.smoothness import demand_smooth

FMU_HELP = """Write MODEL as a functional mock-up unit of FMI, for model exchange and co-simulation.

\b
  mbsrun fmu models/double_pendulum.yaml -o double_pendulum.fmu

\b
Variables
  q_NAME, qd_NAME   states, which are outputs too: coordinates and velocities of joints
  u_NAME            inputs: forces of actuated joints, and wrenches that the model leaves open
  FRAME.x, .y, .z   outputs: places of the model's frames
  step              a parameter: the longest step of co-simulation [s]

The model's run-time parameters are tunable parameters. Derivatives, directional and in FMI 3.0 adjoint, are exact.
Co-simulation takes steps of the classical Runge-Kutta method, as `mbsrun simulate --method rk4` does. The unit holds
the sources, and a library for this machine's system. Closed loops are kept closed by projection. The motion of
driven joints is an input, and their forces are outputs.

\b
Exit codes
  0   written
  2   the model or an argument cannot be accepted; nothing written
"""


@click.command("fmu", cls=ModelCommand, help=FMU_HELP)
@click.argument("model", type=click.Path(path_type=Path))
@click.option(
    "--fmi", type=click.Choice(["2.0", "3.0"]), default="3.0", show_default=True, help="The version of the standard."
)
@click.option(
    "--step",
    type=click.FloatRange(1e-9, 1e3),
    help="The longest step of co-simulation [s]; by default 1 ms.",
)
@click.option("--source-only", "source_only", is_flag=True, help="Leave the library out.")
@click.option("-o", "--output", "out", type=click.Path(path_type=Path), help="The file; by default NAME.fmu.")
@accept_robots
def fmu_command(model: Path, fmi: str, step: float | None, source_only: bool, out: Path | None) -> None:
    """Generate, compile, write."""
    from mbsgen.targets.fmu import list_functions

    needed, optional = list_functions()
    kernels = load(model, extent=Extent(needed, 1, optional=optional))
    demand_smooth(kernels.manifest, "a functional mock-up unit", stops=True)
    out = write_fmu(kernels, out or Path(f"{model.stem}.fmu"), fmi=fmi, step=step, compiled=not source_only)
    say(f"wrote {out}")
