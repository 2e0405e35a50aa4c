"""Bad problem files, by the command: each is refused with exactly these lines, paths, findings and remedies.

The table is bad_problems.yaml: faults of phases, links, impacts, contacts, given forces, states, soft constraints,
delays, recorded motions, unknowns, closed loops, driven joints and quaternions. No file leaves a traceback, or an
output folder.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
import yaml
from click.testing import CliRunner

from mbsgen.errors import InputError
from mbsrun.cli import cli

MODELS = Path(__file__).parents[3] / "models"
TABLE = yaml.safe_load((Path(__file__).parent / "bad_problems.yaml").read_text("utf-8"))
CSV = "time,q[hip] [rad],knee\n" + "".join(f"{t / 4},{0.1 * t},{-0.2 * t}\n" for t in range(5))
LEG = """\
name: leg
gravity: [0, 0, -9.81]
parameters:
  shin: {value: 0.4, kind: differentiated}
  load: {value: 5, kind: runtime}
bodies:
  - {name: rail, joint: {name: x, type: prismatic, axis: x, actuated: false}, mass: 0}
  - {name: trunk, parent: rail, joint: {name: z, type: prismatic, axis: z, actuated: false}, mass: load}
  - name: thigh
    parent: trunk
    joint: {name: hip, type: revolute, axis: y}
    mass: 1
    com: [0, 0, -0.2]
    inertia: [0.02, 0.02, 0.001]
  - name: shank
    parent: thigh
    joint: {name: knee, type: revolute, axis: y, position: [0, 0, -0.4]}
    mass: 0.5
    com: [0, 0, -0.2]
    inertia: [0.01, 0.01, 0.001]
frames:
  - {name: sole, body: shank, position: [0, 0, -shin]}
  - {name: head, body: trunk, position: [0, 0, 0.3]}
wrenches:
  - {name: sole, body: shank, position: [0, 0, -shin], frame: base, force: input}
  - {name: hand, body: trunk, frame: body, force: input}
"""


@dataclass(frozen=True)
class Bad:
    """A file with one change, the lines of all faults that follow, and the method that is asked for."""

    text: str
    old: str
    new: str
    faults: tuple[str, ...]
    method: str = "ipopt"


def list_rows() -> Iterator[tuple[str, Bad]]:
    for kind, part in TABLE.items():
        text = part["text"] if "text" in part else (MODELS / part["file"]).read_text("utf-8")
        for name, row in part["rows"].items():
            yield f"{kind}: {name}", Bad(text, row["old"], row["new"], tuple(row["faults"]), row.get("method", "ipopt"))


ROWS = dict(list_rows())


@pytest.fixture(scope="module")
def folder(requires: Callable[[str], str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    requires("cc")
    found = tmp_path_factory.mktemp("bad")
    (found / "leg.yaml").write_text(LEG, "utf-8")
    (found / "walk.csv").write_text(CSV, "utf-8")
    (found / "all.csv").write_text("t,x,z,hip,knee\n" + "".join(f"{k / 4},0,0,0,0\n" for k in range(5)), "utf-8")
    for name in ("five_bar.yaml", "satellite.yaml", "driven/turntable_arm.yaml"):
        (found / Path(name).name).write_text((MODELS / name).read_text("utf-8"), "utf-8")
    return found


def refuse(folder: Path, text: str, method: str) -> list[str]:
    """Return the lines of a refusal, without the path of the file; nothing else is printed or written."""
    file, out = folder / "p.ocp.yaml", folder / "out"
    file.write_text(text, "utf-8")
    run = CliRunner().invoke(cli, ["solve", str(file), "-o", str(out), "--solver", method])
    assert isinstance(run.exception, InputError), run.output
    assert not run.output
    assert not out.exists()
    return str(run.exception).replace(f"{folder}/", "").splitlines()


@pytest.mark.parametrize("row", ROWS.values(), ids=ROWS.keys())
def test_a_bad_file_is_refused_with_exactly_these_faults(folder: Path, row: Bad) -> None:
    assert row.old in row.text
    found = refuse(folder, row.text.replace(row.old, row.new, 1), row.method)
    assert found == [f"p.ocp.yaml:{fault}" for fault in row.faults]


def test_the_rows_are_more_than_sixty_different_faults() -> None:
    """By finding and remedy, without line and path; each fault has all of the four."""
    faults = [fault for row in ROWS.values() for fault in row.faults]
    assert all(re.fullmatch(r"[1-9]\d*: [a-z][^ ]*: .+; .+", fault) for fault in faults)
    assert len({re.sub(r"^\d+: [^ ]+: ", "", fault) for fault in faults}) > 100


def test_faults_of_all_parts_come_together(folder: Path) -> None:
    """Phases, links, unknowns, contacts and states: one error names all, in the order of lines."""
    text = TABLE["phases"]["text"]
    for old, new in (
        ("guess: 0.5}, shin", "guess: 5}, shin"),
        ("(exc - act)", "(ex - act)"),
        ("[{guess: 0}, 0, {guess: 60}]", "[{guess: 0}, 0, {range: [2, 1], guess: 1}]"),
        ("sensor: sole, axes: xz", "sensor: soul, wrench: sole, axes: xz"),
        ("range: [0.1, 1]}", "range: [0.5, 1]}"),
        ("x: x - stride", "x: abs(x)"),
        ("range: [0, null]", "range: [1, 0]"),
    ):
        assert text.count(old) == 1
        text = text.replace(old, new)
    assert [line.split(": ")[:2] for line in refuse(folder, text, "ipopt")] == [
        ["p.ocp.yaml:7", "unknowns.stride.guess"],
        ["p.ocp.yaml:8", "states.act.rate"],
        ["p.ocp.yaml:15", "phases[0].contacts[0].sensor"],
        ["p.ocp.yaml:16", "phases[0].wrenches.sole.force[2].range"],
        ["p.ocp.yaml:18", "phases[1].horizon.guess"],
        ["p.ocp.yaml:24", "links[0].map.x"],
        ["p.ocp.yaml:26", "links[0].conditions[0].range"],
    ]
