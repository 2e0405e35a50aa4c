"""Options of robots' files, wherever a command of mbsrun takes one for a model."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from mbsgen.importing import Choices, import_model, write_imported
from mbsgen.robots import read_locks
from mbsrun.cli import cli
from mbsrun.models import import_robot

LINK = """<link name="{0}"><inertial><origin xyz="0 0 -0.3"/><mass value="1"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial>
<visual><geometry><box size="0.1234 0.2 0.5"/></geometry></visual></link>"""
JOINT = """<joint name="{0}" type="continuous"><parent link="{1}"/><child link="{2}"/>
<origin xyz="0 0 -0.6"/><axis xyz="0 1 0"/></joint>"""
ARM = f"""<robot name="arm">{"".join(map(LINK.format, ("root", "upper", "lower")))}
{JOINT.format("shoulder", "root", "upper")}{JOINT.format("elbow", "upper", "lower")}</robot>"""


@pytest.fixture
def arm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the file of a robot with two joints, in the current folder."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.urdf").write_text(ARM, encoding="utf-8")
    return Path("arm.urdf")


def list_commands(group: click.Group) -> Iterator[click.Command]:
    for command in group.commands.values():
        yield from list_commands(command) if isinstance(command, click.Group) else (command,)


def test_every_command_on_a_model_takes_the_options_of_robots() -> None:
    options = {"--base", "--sensor", "--lock", "--lock-massless", "--mimic"}
    found = {
        str(command.name): {text for parameter in command.params for text in parameter.opts}
        for command in list_commands(cli)
        if any(parameter.name == "model" for parameter in command.params)
    }
    assert len(found) > 10
    assert [name for name, own in found.items() if not options <= own] == []


def test_an_animation_of_an_imported_model_shows_the_shapes_of_its_file(arm: Path) -> None:
    """With the elbow held, the shoulder is the one coordinate of the motion."""
    Path("motion.csv").write_text("time,shoulder\n0,0\n1,1\n", encoding="utf-8")
    refused = CliRunner().invoke(cli, ["animate", str(arm), "motion.csv"])
    assert refused.exit_code != 0
    run = CliRunner().invoke(cli, ["animate", str(arm), "motion.csv", "--lock", "elbow=30 deg"], catch_exceptions=False)
    assert run.exit_code == 0
    assert Path("arm.html").read_text(encoding="utf-8").count("0.1234") == 3


def test_the_imported_model_is_the_one_that_mbsgen_writes(arm: Path) -> None:
    for angle in (0.3, 0.4):
        locked = (("elbow", angle),)
        path, warnings = import_robot(arm, {"locked": locked, "base": "floating"})
        assert path.name == "arm.yaml"
        expected = import_model(arm, Choices(locked=locked, base="floating"))
        assert path.read_text(encoding="utf-8") == write_imported(expected)
        assert warnings == tuple(str(notice) for notice in expected.notices if notice.alters)


@pytest.mark.parametrize("option", [["--base", "fixed"], ["--lock", "q1=0"], ["--lock-massless"]])
def test_the_options_are_refused_without_a_robots_file(option: list[str]) -> None:
    run = CliRunner().invoke(cli, ["linearise", "acrobot.yaml", *option])
    options = "--base, --sensor, --lock, --lock-massless, --mimic and --loop-tolerance"
    expected = f"acrobot.yaml: {options} are for files of URDF, MJCF, SDF or OpenSim"
    assert str(run.exception) == expected


def test_locks_are_numbers_or_expressions() -> None:
    assert read_locks(["a=b=180 deg"]) == (("a=b", pytest.approx(3.141592653589793)),)
    with pytest.raises(click.BadParameter, match="gives no joint a number"):
        read_locks(["elbow=1/0"])
