"""Robots in URDF, as text."""

from __future__ import annotations

from pathlib import Path

LINK = """<link name="{name}">
  <inertial><origin xyz="{com}" rpy="{rpy}"/><mass value="{mass}"/>
    <inertia ixx="0.02" ixy="0.001" ixz="-0.002" iyy="0.03" iyz="0.003" izz="0.025"/></inertial>
</link>"""


def link(name: str, mass: float = 1.0, com: str = "0.1 -0.2 0.05", rpy: str = "0.3 -0.2 0.5") -> str:
    return LINK.format(name=name, mass=mass, com=com, rpy=rpy)


def joint(name: str, kind: str, parent: str, child: str, inner: str = "", rpy: str = "0.1 0.7 -0.4") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><origin xyz="0.2 0.1 -0.3" rpy="{rpy}"/>'
        f'<parent link="{parent}"/><child link="{child}"/>{inner}</joint>'
    )


LIMIT = '<limit lower="-1" upper="2" effort="5" velocity="3"/>'
LOSSES = '<dynamics damping="0.5" friction="0.2"/>'


def write(folder: Path, inner: str, name: str = "machine") -> Path:
    path = folder / "machine.urdf"
    path.write_text(f'<?xml version="1.0"?>\n<robot name="{name}">\n{inner}\n</robot>\n', encoding="utf-8")
    return path
