"""`mbsrun linearise`: a model at rest -> its linear equations, modes, transfer functions and a regulator."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from mbsgen.expressions import spell
from mbsgen.help import ModelCommand
from mbsrun.closure import Closure
from mbsrun.commands.animated import equip, read_end
from mbsrun.commands.console import choose_format, print_table, read_numbers, say
from mbsrun.commands.robots import accept_robots
from mbsrun.external import load
from mbsrun.linearisation import Equilibrium, Linearisation, balance, find_pose, linearise, settle
from mbsrun.linearisation.equations import LOST
from mbsrun.linearisation.pictures import plot_poles, plot_responses
from mbsrun.models import INTEGRATED
from mbsrun.smoothness import demand_smooth

LINEARISE_HELP = """Linearise the equations of motion of MODEL about a pose at rest.

--pose gives the pose; other coordinates are the model's, or follow from loops. Driven joints stand still. By default,
inputs that --input does not give are chosen such that the pose is an equilibrium. With --settle the pose moves instead,
to an equilibrium under the given inputs.

\b
  mbsrun linearise models/cart_pole.yaml --pose pole=pi --regulate 0.1 --weigh pole=10

The table has a row for each pole, or pair of poles: frequency, damping ratio, and whether it is controllable by the
inputs and observable from coordinates and frames. Its last column names the coordinates that move the most.

\b
The output folder gets
  linearisation.json   pose, inputs, forces of driven joints, M, C, K, F, A, B, G, poles, zeros, gains;
                       under "excitation", the matrices of the motion of driven joints
  poles.png            poles in the complex plane
  responses.png        transfer functions from inputs, and from the motion of driven joints, to coordinates

\b
Exit codes
  0   written
  2   the model or an argument cannot be accepted, or the pose is no equilibrium; nothing written
"""

WEAK = 1e-4  # singular value of J, relative to the largest: loops near a singular pose
_PRINTED = 1e-12  # of the largest gain of an input: smaller ones are roundings, and are not printed
_SHARE = 0.3  # of the largest entry of a mode's shape: joints that move less are not named


@click.command(
    "linearise",
    cls=ModelCommand,
    help=LINEARISE_HELP,
)
@click.argument("model", type=click.Path(path_type=Path))
@click.option("--pose", "poses", multiple=True, metavar="NAME=NUMBER", help="A coordinate [rad, m]: --pose pole=pi")
@click.option("--input", "inputs", multiple=True, metavar="NAME=NUMBER", help="A constant input [N m, N].")
@click.option("--settle", "settles", is_flag=True, help="Find an equilibrium near the pose; inputs are 0 or given.")
@click.option(
    "--regulate",
    "weight",
    type=click.FloatRange(0, 1e12, min_open=True),
    metavar="W",
    help="Also find the gains that minimise the integral of |x|² + |ẋ|² + W |u|².",
)
@click.option(
    "--weigh",
    "weights",
    multiple=True,
    metavar="NAME=Q",
    help="With --regulate: the weight of a squared coordinate (NAME) or of a squared velocity (qd_NAME).",
)
@click.option(
    "--weigh-input",
    "input_weights",
    multiple=True,
    metavar="NAME=R",
    help="With --regulate: the weight of this squared input, in place of W.",
)
@click.option(
    "--solution",
    type=click.Path(path_type=Path),
    help="A solution.json of `mbsrun solve`: the pose where it ends, and its parameters.",
)
@click.option("-o", "--output", "out", type=click.Path(path_type=Path), help="The folder; by default NAME.linear.")
@choose_format
@accept_robots
def linearise_command(
    model: Path,
    poses: Sequence[str],
    inputs: Sequence[str],
    settles: bool,
    weight: float | None,
    weights: Sequence[str],
    input_weights: Sequence[str],
    solution: Path | None,
    out: Path | None,
) -> None:
    """Read, compute, write, print."""
    kernels = load(model, extent=INTEGRATED)
    demand_smooth(kernels.manifest, "a linearisation", stops=False)
    if weight is None and (weights or input_weights):
        raise click.UsageError("--weigh and --weigh-input are for --regulate; give it too")
    start = None
    if solution is not None:
        kernels = equip(kernels, model, INTEGRATED, solution)
        start = read_end(solution, kernels.manifest)
    manifest = kernels.manifest
    names = [manifest.coordinates[i].name for i in manifest.actuated]
    pose = find_pose(kernels, read_numbers(poses, manifest.positions, "--pose"), start)
    given = {names.index(name): value for name, value in read_numbers(inputs, names, "--input").items()}
    if settles:
        u = np.zeros(len(names))
        u[list(given)] = list(given.values())
        equilibrium = settle(kernels, pose, u)
    else:
        equilibrium = balance(kernels, pose, given)
    found = linearise(kernels, equilibrium)
    if (strength := Closure(kernels).measure_strength(equilibrium.q)) < WEAK:
        say(
            "the equations of the loops almost depend on each other at this pose (the least singular value of J is "
            f"{strength:.1g} of the largest): the motion may branch here, and poles are no measure of it"
        )
    gains = None if weight is None else found.regulate(*_read_weights(found, weight, weights, input_weights))
    out = out or Path(f"{model.stem}.linear")
    out.mkdir(parents=True, exist_ok=True)
    text = json.dumps(_summarise(found, manifest.positions, gains), indent=1, ensure_ascii=False, allow_nan=False)
    (out / "linearisation.json").write_text(text + "\n", encoding="utf-8")
    plot_poles(found, out / "poles.png")
    if found.inputs or found.driven:
        plot_responses(found, out / "responses.png")
    _show(found, equilibrium, manifest.positions, gains)
    say(f"wrote {out}")


def _read_weights(
    found: Linearisation, weight: float, states: Sequence[str], inputs: Sequence[str]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the weights of inputs and states; the ones that are not given are W, and 1."""
    names = [*found.freedoms, *(f"qd_{name}" for name in found.freedoms)]
    own, given = read_numbers(states, names, "--weigh"), read_numbers(inputs, found.inputs, "--weigh-input")
    R = np.array([given.get(name, weight) for name in found.inputs])
    return R, np.array([own.get(name, 1.0) for name in names])


def _show(found: Linearisation, at: Equilibrium, positions: Sequence[str], gains: NDArray[np.float64] | None) -> None:
    """Print the equilibrium, the poles, and the gains as inputs of `mbsrun simulate`."""
    click.echo("pose    " + ", ".join(f"{name} = {value:.6g}" for name, value in zip(positions, at.q, strict=True)))
    if found.inputs:
        click.echo("inputs  " + ", ".join(f"{name} = {u:.6g}" for name, u in zip(found.inputs, at.u, strict=True)))
    if found.driven:
        click.echo("driven  " + ", ".join(f"{name} = {x:.6g}" for name, x in zip(found.driven, at.tau, strict=True)))
    table = Table(box=None, pad_edge=False)
    for heading in ("pole [1/s]", "frequency [Hz]", "damping", "controllable", "observable", "moves"):
        table.add_column(heading, justify="left" if heading == "moves" else "right")
    for mode in found.modes:
        sign = " ± " if mode.pole.imag else ""
        pole = f"{mode.pole.real:.5g}{sign}{f'{mode.pole.imag:.5g}i' if sign else ''}"
        moving = [n for n, x in zip(found.freedoms, np.abs(mode.shape), strict=True) if x >= _SHARE]
        reached = ("yes" if x > LOST else "no" for x in (mode.controllable, mode.observable))
        table.add_row(pole, f"{mode.frequency:.5g}", f"{mode.damping:.4g}", *reached, ", ".join(moving))
    print_table(table)
    click.echo("stable" if found.is_stable else "not asymptotically stable")
    if gains is not None:
        feedback = _write_feedback(found, at, positions, gains)
        for line in feedback:
            click.echo(f"--input '{line}'")
        if not feedback:
            say("the gains are only in linearisation.json: an expression cannot name all of their joints")


def _write_feedback(
    found: Linearisation, at: Equilibrium, positions: Sequence[str], gains: NDArray[np.float64]
) -> list[str]:
    """Write each input as an expression of the state, as `mbsrun simulate` takes it; none where a joint has no name."""
    named, rest, lines = (
        dict(zip(positions, spell(positions), strict=True)),
        dict(zip(positions, at.q, strict=True)),
        [],
    )
    words = [(word, rest[x]) for x in found.freedoms if (word := named.get(x)) is not None]
    if len(words) < len(found.freedoms):
        return []  # turns of quaternions are no coordinates
    states = [*(_write_change(word, place) for word, place in words), *(f"qd_{word}" for word, _ in words)]
    for name, u, row in zip(found.inputs, at.u, gains, strict=True):
        held = np.where(np.abs(row) > _PRINTED * np.abs(row).max(), -row, 0.0)
        lines.append(f"{name}={_write_sum([(u, '1'), *zip(held.tolist(), states, strict=True)])}")
    return lines


def _write_sum(terms: Sequence[tuple[float, str]]) -> str:
    """Write a sum of numbers, each times a factor, without the terms that are 0."""
    written = [f"{'-' if x < 0 else '+'} {abs(x):.12g}*{factor}".removesuffix("*1") for x, factor in terms if x]
    text = " ".join(written).removeprefix("+ ") or "0"
    return f"-{text[2:]}" if text.startswith("- ") else text


def _write_change(word: str, rest: float) -> str:
    """Write the distance of a coordinate from its place at rest."""
    return f"(q_{word} {'-' if rest > 0 else '+'} {abs(rest):.12g})" if rest else f"q_{word}"


def _summarise(found: Linearisation, positions: Sequence[str], gains: NDArray[np.float64] | None) -> dict[str, Any]:
    at, d = found.equilibrium, len(found.freedoms)
    return {
        "pose": dict(zip(positions, at.q.tolist(), strict=True)),
        "inputs": dict(zip(found.inputs, at.u.tolist(), strict=True)),
        "driven": dict(zip(found.driven, at.tau.tolist(), strict=True)),
        "multipliers": at.multipliers.tolist(),
        "freedoms": found.freedoms,
        "outputs": found.outputs,
        **{name: getattr(found, name).tolist() for name in ("M", "C", "K", "F", "A", "B", "G")},
        "excitation": {name: getattr(found.excitation, name).tolist() for name in ("M", "C", "K", "G")},
        "modes": [
            {
                "pole": [mode.pole.real, mode.pole.imag],
                "frequency": mode.frequency,
                "damping": mode.damping,
                "controllable": mode.controllable,
                "observable": mode.observable,
                "shape": [[x.real, x.imag] for x in mode.shape.tolist()],
            }
            for mode in found.modes
        ],
        "zeros": {
            f"{output} by {name}": [[z.real, z.imag] for z in found.find_zeros(i, k).tolist()]
            for k, name in enumerate(found.inputs)
            for i, output in enumerate(found.outputs[:d])
        },
        "stable": found.is_stable,
        "gains": None if gains is None else gains.tolist(),
    }
