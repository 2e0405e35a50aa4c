"""File formats: which one a file has, and a new one that is one entry."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import pytest
from click.testing import CliRunner

from mbsgen.cli import cli
from mbsgen.errors import Fault, InputError
from mbsgen.importing import Choices, Imported, Notice, formats, import_model, list_formats
from mbsgen.importing.formats import FORMATS, Format, Source
from mbsgen.model.construction import body, make_model, revolute
from mbsgen.model.reader import read_model
from mbsgen.pipeline import read_tree
from mbsrun.models import Extent, find_folder


def test_a_file_of_no_format_is_refused_with_what_there_is(tmp_path: Path) -> None:
    advice = {
        "page": "give a file of URDF (<robot>), MJCF (<mujoco>), SDF (<sdf>) or OpenSim (<OpenSimDocument>)",
        "mujocoinclude": "import the file that",
    }
    for tag, remedy in advice.items():
        file = tmp_path / "robot.xml"
        file.write_text(f"<{tag}/>", encoding="utf-8")
        with pytest.raises(InputError) as caught:
            import_model(file)
        assert f"robot.xml:1: {tag}: the file is <{tag}>; " in str(caught.value)
        assert remedy in str(caught.value)


def read_chain(source: Source, choices: Choices) -> Imported:
    """Read a chain of rods: a line each with its length and its mass."""
    lines = source.path.read_text(encoding="utf-8").splitlines()[1:]
    bodies, carrier, reach = [], "base", 0.0
    for k, line in enumerate(lines, 1):
        try:
            length, mass = map(float, line.split())
        except ValueError:
            raise InputError([Fault(str(source.path), k + 1, "", "no rod", "give a length and a mass")]) from None
        turned = revolute("y", position=(0, 0, -reach))
        bodies.append(body(f"rod{k}", turned, parent=carrier, mass=mass, com=(0, 0, -length / 2)))
        carrier, reach = f"rod{k}", length
    model = make_model(choices.name or "chain", bodies, gravity=choices.gravity or (0, 0, -9.81))
    return Imported(model, (Notice(str(source.path), 1, "", "rods are thin", alters=False),))


CHAIN = Format(
    "rods",
    (".rods",),
    "first line `rods`",
    lambda source: source.path.read_text(encoding="utf-8").startswith("rods\n"),
    read_chain,
)


def test_a_new_format_is_a_reader_and_an_entry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Imported, checked, generated from the command line, and by the solving side; faults name their places."""
    file, wrong, other = (tmp_path / name for name in ("chain.rods", "wrong.rods", "other.rods"))
    file.write_text("rods\n0.5 2\n0.3 1\n", encoding="utf-8")
    wrong.write_text("rods\n0.5\n", encoding="utf-8")
    other.write_text("balls\n", encoding="utf-8")
    import_module("mbsgen.commands.import_")  # its help lists the formats once, for the whole process
    monkeypatch.setattr(formats, "FORMATS", (*FORMATS, CHAIN))
    assert list_formats() == "URDF, MJCF, SDF, OpenSim or rods"
    assert [x.name for x in read_tree(file).bodies] == ["rod1", "rod2"]

    run = CliRunner().invoke(cli, ["import", str(file), "--name", "pair", "-o", str(tmp_path / "pair.yaml")])
    assert run.exit_code == 0, run.output
    assert read_model(tmp_path / "pair.yaml") == import_model(file, Choices(name="pair")).model
    assert (find_folder(file, Extent(("impl",), derivatives=0)) / "chain.h").is_file()

    with pytest.raises(InputError, match=r"wrong.rods:2: no rod; give a length and a mass"):
        read_tree(wrong)
    with pytest.raises(InputError, match=r"other.rods: .*no format.*; give a file of rods \(first line `rods`\)"):
        read_tree(other)
