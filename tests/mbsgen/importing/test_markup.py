"""Untrusted XML: nothing is expanded, nothing outside is read, nothing grows, and no fault is a traceback."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import pytest
from click.testing import CliRunner
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mbsgen.cli import cli
from mbsgen.errors import InputError
from mbsgen.importing import import_model
from mbsgen.importing.markup import MAX_BYTES, MAX_DEPTH, MAX_ELEMENTS, read_markup

LAUGHS = '<!DOCTYPE robot [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;">]><robot name="&b;"/>'
OUTSIDE = '<!DOCTYPE robot [<!ENTITY x SYSTEM "file:///etc/passwd">]><robot>&x;</robot>'
PENDULUM = """<robot name="pendulum">
  <link name="stand"/>
  <link name="rod"><inertial><mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.001"/></inertial></link>
  <joint name="hinge" type="continuous"><parent link="stand"/><child link="rod"/><axis xyz="0 1 0"/></joint>
</robot>
"""


def refuse(folder: Path, text: str | bytes) -> str:
    path = folder / "robot.urdf"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError) as caught:
        import_model(path)
    return str(caught.value).removeprefix(str(path))


@pytest.mark.parametrize(
    ("text", "finding"),
    [
        (LAUGHS, ":1: a document type or an entity is declared"),
        (OUTSIDE, ":1: a document type or an entity is declared"),
        ('<!DOCTYPE robot SYSTEM "http://x/y.dtd"><robot/>', ":1: a document type or an entity is declared"),
        ("<robot>\n<link>\n</robot>", ":3: this is no XML: mismatched tag"),
        ("", ":1: this is no XML: no element found"),
        ("<a>" * (MAX_DEPTH + 1), f":1: nested deeper than {MAX_DEPTH} elements"),
        (f"<robot>{'<a/>' * MAX_ELEMENTS}</robot>", f":1: more than {MAX_ELEMENTS} elements"),
        ("<robot " + " ".join(f"a{i}='1'" for i in range(99)) + "/>", ":1: an element of 99 attributes"),
        (b" " * (MAX_BYTES + 1), f": larger than {MAX_BYTES} bytes"),
        (b'<?xml version="1.0" encoding="none"?><robot/>', ":1: "),
        ("<sdf/>", ":1: sdf: an <sdf> without a version; give the version"),
        (
            "<html/>",
            ":1: html: the file is <html>; give a file of URDF (<robot>), MJCF (<mujoco>), SDF (<sdf>) or OpenSim "
            "(<OpenSimDocument>)",
        ),
    ],
)
def test_what_is_refused(tmp_path: Path, text: str | bytes, finding: str) -> None:
    assert refuse(tmp_path, text).startswith(finding)


def test_elements_know_their_lines_and_paths(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(PENDULUM, encoding="utf-8")
    axis = next(element for element in read_markup(path).walk() if element.tag == "axis")
    assert (axis.line, axis.path) == (4, "robot/joint[hinge]/axis")


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_a_damaged_file_is_a_model_or_has_faults(tmp_path: Path, data: st.DataObject) -> None:
    """Some bytes of a good file are replaced or cut out; whatever comes of it, nothing but InputError is raised."""
    raw = bytearray(PENDULUM.encode())
    for _ in range(data.draw(st.integers(1, 4))):
        start = data.draw(st.integers(0, len(raw) - 1))
        raw[start : start + data.draw(st.integers(0, 6))] = data.draw(
            st.binary(max_size=3)
            | st.sampled_from([b"nan", b"1e999", b"-1", b"0 0 0", b"<a>", b'"', b"</link>", b"fixed"])
        )
    path = tmp_path / "robot.urdf"
    path.write_bytes(bytes(raw))
    with suppress(InputError):
        import_model(path)


def test_the_command_writes_a_model_file_and_tells_what_it_does_not_say(tmp_path: Path) -> None:
    path, out = tmp_path / "robot.urdf", tmp_path / "robot.yaml"
    path.write_text(PENDULUM, encoding="utf-8")
    done = CliRunner().invoke(cli, ["import", str(path), "-o", str(out), "--name", "swing", "--gravity", "0,0,-1.6"])
    assert done.exit_code == 0
    assert "name: swing\ngravity: [0, 0, -1.6]" in out.read_text(encoding="utf-8")
    assert CliRunner().invoke(cli, ["show", str(path)]).stdout.splitlines()[0] == "pendulum: base"
    for option in (["--lock", "hinge"], ["--lock", "hinge=x"], ["--gravity", "1,2"]):
        assert CliRunner().invoke(cli, ["import", str(path), *option]).exit_code == 2
