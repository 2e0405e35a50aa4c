"""Ranges of MuJoCo's tendons as stops: their numbers are MuJoCo's lengths; warnings name the rest."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mbsgen.errors import InputError
from mbsgen.importing.choices import Choices, Imported
from mbsgen.importing.formats import import_model
from mbsgen.model.model import Model
from mbsgen.model.writer import write_model
from mbsrun import load
from mbsrun.models import Extent

INERTIAL = '<inertial pos="0.3 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>'
TEXT = f"""<mujoco><compiler angle="radian" autolimits="true"/>
<default><tendon range="-0.5 0.5"/></default>
<worldbody><site name="top" pos="0 0 1"/>
<body name="a"><joint name="one" axis="0 1 0"/>{INERTIAL}<site name="in a" pos="0.5 0 0.1"/>
<body name="b" pos="1 0 0"><joint name="two" axis="0 0 1" ref="0.2"/>{INERTIAL}<site name="in b" pos="0.5 0 0.1"/>
</body></body></worldbody>
<tendon>
<fixed name="sum"><joint joint="one" coef="2"/><joint joint="two" coef="-0.5"/></fixed>
<spatial name="cord" range="0 2.2"><site site="top"/><site site="in a"/><site site="in b"/></spatial>
<spatial name="block" range="0.1 3"><site site="top"/><site site="in a"/><pulley divisor="2"/><site site="top"/>
<site site="in b"/></spatial>
</tendon></mujoco>"""


def bring(text: str, folder: Path, **choices: object) -> Imported:
    path = folder / "tendons.xml"
    path.write_text(text, encoding="utf-8")
    return import_model(path, Choices(**choices))  # type: ignore[arg-type]


def warnings(imported: Imported) -> list[str]:
    return [str(x) for x in imported.notices if x.alters]


def name_stops(model: Model) -> list[str]:
    return [x.name for x in model.stops]


def test_the_numbers_are_the_lengths_of_the_tendons(tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    imported = bring(TEXT, tmp_path, stops=0.2)
    assert not [x for x in warnings(imported) if "tendon" in x]
    assert name_stops(imported.model) == ["sum", "cord", "block"]
    file = tmp_path / "tendons.yaml"
    file.write_text(write_model(imported.model), encoding="utf-8")
    found = load(file, extent=Extent(("touching", "impl"), 1))
    peer = mujoco.MjModel.from_xml_string(TEXT)
    data = mujoco.MjData(peer)
    for q in np.random.default_rng(1).normal(size=(5, 2)):
        data.qpos[:] = q
        mujoco.mj_forward(peer, data)
        lower, upper = found("touching", q=q)["clearance"].reshape(3, 2).T
        assert lower + peer.tendon_range[:, 0] == pytest.approx(data.ten_length, abs=1e-12)
        assert peer.tendon_range[:, 1] - upper == pytest.approx(data.ten_length, abs=1e-12)
    assert {point.restitution for point in found.manifest.rigid} == {0.2}


def test_a_held_joint_is_a_number_and_a_range_that_nothing_changes_is_left_out(tmp_path: Path) -> None:
    imported = bring(TEXT, tmp_path, stops=0.0, locked=(("one", 0.1),))
    assert name_stops(imported.model) == ["sum", "cord", "block"]
    held = TEXT.replace('<joint joint="two" coef="-0.5"/>', "")
    assert name_stops(bring(held, tmp_path, stops=0.0, locked=(("one", 0.1),)).model) == ["cord", "block"]


def test_what_is_left_out_is_told(tmp_path: Path) -> None:
    without = [x for x in warnings(bring(TEXT, tmp_path)) if "tendon" in x]
    assert len(without) == 3
    assert all("with --stops 0 its range makes stops" in x for x in without)
    sprung = TEXT.replace('name="cord"', 'name="cord" stiffness="3" damping="1"')
    (warning,) = (x for x in warnings(bring(sprung, tmp_path, stops=0.2)) if "tendon" in x)
    assert "stiffness and damping of a tendon: left out" in warning
    around = TEXT.replace(
        '<site site="in a"/><site site="in b"/></spatial>', '<geom geom="g"/><site site="in b"/></spatial>'
    )
    (warning,) = (x for x in warnings(bring(around, tmp_path, stops=0.2)) if "tendon" in x)
    assert "spatial (tendon) is not part of a model" in warning


@pytest.mark.parametrize(
    ("old", "new", "finding"),
    [
        ('joint="two" coef', 'joint="twa" coef', 'there is no hinge or slide "twa"'),
        ('<site site="in a"/><site', '<site site="in c"/><site', 'there is no site "in c"'),
        ('range="0 2.2"', 'range="2 1" limited="true"', "range is 2 to 1"),
    ],
)
def test_a_fault_has_a_finding(old: str, new: str, finding: str, tmp_path: Path) -> None:
    assert TEXT.count(old) == 1
    with pytest.raises(InputError, match=finding):
        bring(TEXT.replace(old, new), tmp_path, stops=0.2)
