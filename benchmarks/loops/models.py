"""The model files of the loop benchmarks; `python -m benchmarks.loops.models N` prints the one of N four-bars.

A02 of the IFToMM library of multibody benchmarks: N + 1 upright rods on the base and N level ones between their ends,
all of 1 m and 1 kg.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

FOLDER = Path(__file__).parents[1] / "models" / "loops"
NAMES = ("pendulum_rod", "double_pendulum_rods", "four_bars", "andrews", "bricard", "flyball")

_HEAD = """\
# {title}, A02 of the IFToMM library of multibody benchmarks: rods of 1 m and 1 kg, {uprights} upright
# ones on the base and {bars} level ones between their ends. At first B0, the end of the first, moves by 1 m/s along x.
# With all rods on one line there are {uprights} freedoms instead of one.
# `python -m benchmarks.loops.models {bars}` prints this.

name: {name}
gravity: [0, -9.81, 0]

parameters:
  l: 1
  m: 1
  thin: m*l**2/12

bodies:
"""


def find_model(name: str) -> Path:
    """Return the path of a model file by its name."""
    return FOLDER / f"{name}.yaml"


def write_four_bars(bars: int) -> str:
    """Return the model file of N four-bars in a row."""
    name = "four_bars" if bars == 2 else f"four_bars{bars}"
    title = "Two four-bars" if bars == 2 else f"{bars} four-bars"
    head = _HEAD.format(name=name, title=title, bars=bars, uprights=bars + 1)
    return head + "\n".join(_list_lines(bars)) + "\n"


def _list_lines(bars: int) -> Iterator[str]:
    for i in range(bars + 1):
        yield from _write_rod(f"upright{i}", "", f"a{i}", f"[{i}*l, 0, 0]", "[0, l/2, 0]", "[thin, 0, thin]")
        if i < bars:
            parent = f"upright{i}"
            yield from _write_rod(f"level{i + 1}", parent, f"b{i + 1}", "[0, l, 0]", "[l/2, 0, 0]", "[0, thin, thin]")
    yield "loops:"
    for i in range(1, bars + 1):
        ends = f"from: {{body: level{i}, position: [l, 0, 0]}}, to: {{body: upright{i}, position: [0, l, 0]}}"
        yield f"  - {{name: B{i}, type: hinge, {ends}}}"
    yield ""
    yield "independent: [a0]"
    yield ""
    yield "frames:"
    yield "  - {name: B0, body: upright0, position: [0, l, 0]}"


def _write_rod(name: str, parent: str, joint: str, position: str, com: str, inertia: str) -> Iterator[str]:
    yield f"  - name: {name}"
    if parent:
        yield f"    parent: {parent}"
    yield f"    joint: {{name: {joint}, type: revolute, axis: z, actuated: false, position: {position}}}"
    yield "    mass: m"
    yield f"    com: {com}"
    yield f"    inertia: {inertia}"
    yield ""


if __name__ == "__main__":
    sys.stdout.write(write_four_bars(int(sys.argv[1])))
