"""`mbsgen show`: the tree of a model, and its picture."""

from __future__ import annotations

import difflib
import math
from pathlib import Path

import click
from rich.console import Console
from rich.text import Text
from rich.tree import Tree as Branches

from mbsgen.assembly.poses import reach
from mbsgen.commands.importing import MODEL, importing, read_model
from mbsgen.help import ModelCommand
from mbsgen.importing import Choices
from mbsgen.model.tree import Tree
from mbsgen.output import write_file
from mbsgen.pipeline import read_tree
from mbsgen.robots import read_finite

_UNCUT = 10_000  # characters in a line, so that neither a pipe nor a narrow terminal cuts text off
_AT = "Coordinates of the drawing, rad or m; 0 by default, or where the loops are closed."


@click.command("show", cls=ModelCommand)
@MODEL
@click.option("-o", "--output", "out", type=click.Path(path_type=Path), help="The picture to write: .png or .svg.")
@click.option("--at", "coordinates", metavar="q1=0.3,...", help=_AT)
@importing
def show_command(model: Path, out: Path | None, coordinates: str | None, choices: Choices) -> None:
    """Print the tree of MODEL; with -o, draw it.

    The tree lists bodies, joints and masses, and the indices, from 0, of joints in q and u and of frames among sensors.
    The picture shows the tree beside the mechanism in space.
    """
    from mbsgen.drawing import FORMATS, describe_joint, describe_loop, list_masses, render  # takes long to load

    form = "" if out is None else out.suffix.removeprefix(".").lower()
    if out is not None and form not in FORMATS:
        raise click.BadParameter(f"{out} is neither a .png nor a .svg", param_hint="-o")
    tree = read_tree(read_model(model, choices))
    q = _read_coordinates(tree, coordinates or "")
    branches = {0: Branches(Text(f"{tree.name}: base"))}
    places = _find_places(tree)
    for i, (body, mass) in enumerate(zip(tree.bodies, list_masses(tree), strict=True), 1):
        limits = _describe_limits(body.joint.lower, body.joint.upper)
        words = f" {body.joint.name}: {describe_joint(tree, i)}{limits}, {mass:.6g} kg"
        place = Text(f"  {places[i]}" if places[i] else "", style="dim")
        branches[i] = branches[body.parent].add(Text.assemble((body.name, "bold"), words, place))
    for k, sensor in enumerate(tree.sensors):
        named = Text.assemble((f"frame {sensor.name}", "italic"), (f"  sensor {k}", "dim"))
        branches[sensor.body].add(named)
    for loop in tree.loops:
        branches[0].add(Text.assemble((f"loop {loop.name}", "italic"), f": {describe_loop(tree, loop)}"))
    for constraint in tree.constraints:
        branches[0].add(Text.assemble((f"constraint {constraint.name}", "italic")))
    if out is not None:
        write_file(render(tree, q, form), out)
        click.echo(f"wrote {out}", err=True)
    Console(width=_UNCUT, highlight=False).print(branches[0])


def _find_places(tree: Tree) -> dict[int, str]:
    """Return the indices, from 0, of each body's joint in q, in qd where these differ, and in u, as in the header."""
    followers, places = tree.followers, {}
    seen = {"qd": 0, "u": 0}
    for i, body in enumerate(tree.bodies, 1):
        own = []
        if i not in followers:
            if body.joint.name in tree.coordinates:
                own.append(f"q {tree.coordinates.index(body.joint.name)}")
            if tree.quaternions:
                own.append(f"qd {seen['qd']}")
            seen["qd"] += 1
        for x in tree.quaternions:
            if x.first == i:
                first = tree.coordinates.index(x.coordinates[0])
                own.insert(0, f"q {first}..{first + len(x.coordinates) - 1}")
        if body.joint.actuated:
            own.append(f"u {seen['u']}")
            seen["u"] += 1
        places[i] = f"[{', '.join(own)}]" if own else ""
    return places


def _describe_limits(lower: float | None, upper: float | None) -> str:
    if lower is None and upper is None:
        return ""
    return f", {'' if lower is None else f'{lower:.4g}'}..{'' if upper is None else f'{upper:.4g}'}"


def _read_coordinates(tree: Tree, text: str) -> list[float]:
    """Read `name=number,...` as the coordinates of all joints, the others of which close the loops.

    Raises click.BadParameter with all faults.
    """
    values = dict(zip(tree.coordinates, tree.closure.pose if tree.closure else tree.neutral, strict=True))
    given: dict[int, float] = {}
    faults = []
    for part in filter(str.strip, text.split(",")):
        name, sign, written = (word.strip() for word in part.rpartition("="))
        if not sign:
            faults.append(f"{written}: it gives no joint a number; write, for example, {next(iter(values))}=0.3")
            continue
        if name not in values:
            near = difflib.get_close_matches(name, values, 1) or list(values)[:3]
            faults.append(f"{part.strip()}: no joint is called {name!r}; there is {', '.join(near)}")
            continue
        values[name] = read_finite(written)
        if not math.isfinite(values[name]):
            faults.append(f"{part.strip()}: {written!r} is no number; write, for example, {name}=0.3")
        given[tree.coordinates.index(name)] = values[name]
    if faults:
        raise click.BadParameter("\n  ".join(faults), param_hint="--at")
    if tree.closure is None or not given:
        return list(values.values())
    if (found := reach(tree, given)) is None:
        raise click.BadParameter("the loops do not close there; give other coordinates, or fewer", param_hint="--at")
    return [float(x) for x in found]
