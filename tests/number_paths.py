"""Numbers in the data of a model file, by the paths that run-time parameters have there."""

from __future__ import annotations

from typing import Any

from mbsgen.documents import take
from mbsgen.expressions import write
from mbsgen.model.expansion import label_joints
from mbsgen.model.joints import find_joint_type
from mbsgen.model.joints.compound import CompoundSection
from mbsgen.model.model import Joint
from mbsgen.model.sections import SettingSection, read_direction, read_matrix, read_quaternion
from mbsgen.model.tree import Motion

Data = dict[str, Any]


def set_number(data: Data, path: str, value: float) -> None:
    """Write a number into the data of a model file, at the path of a run-time parameter."""
    if path in data.get("parameters", {}):
        given = data["parameters"][path]
        data["parameters"][path] = given | {"value": value} if isinstance(given, dict) else value
        return None
    if path.startswith("gravity."):
        data["gravity"]["xyz".index(path[-1])] = value
        return None
    for section in ("frames", "wrenches"):
        for item in data.get(section, []):
            if path.startswith(start := f"{section}.{item['name']}."):
                return _write(item, path.removeprefix(start).split("."), value)
    for section in ("loops", "forces", "contacts"):
        for item in data.get(section, []):
            if path.startswith(start := f"{section}.{item['name']}."):
                key, *place = path.removeprefix(start).split(".")
                inner = key in ("from", "to", "plane", "sphere", "box", "capsule", "wheel")
                return _write(item.setdefault(key, {}), place, value) if inner else _write(item, [key, *place], value)
    owners = [(name, owner) for name, owner in _list_owners(data) if path.startswith(f"{name}.")]
    for name, owner in owners:
        place = path.removeprefix(f"{name}.").split(".")
        if place[0] in _list_keys(owner):
            return _write(owner, place, value)
    raise AssertionError(f"no place in the file is called {path}")


def _list_keys(owner: Data) -> tuple[str, ...]:
    """List the keys that a mapping of the file can have: of a body, or of a joint."""
    if "joint" in owner:
        return "mass", "com", "inertia"
    law = ("stiffness", "rest", "damping", "friction", "force", "armature")
    if "type" not in owner:
        return law
    place = ("position", "orientation")
    if not issubclass(find_joint_type(owner["type"]), SettingSection):
        return place
    return (*place, *law, "a", "alpha", "d", "theta") if owner["type"] == "dh" else (*place, *law)


def _list_owners(data: Data) -> list[tuple[str, Data]]:
    """List bodies and joints by their names, as the documentation gives them."""
    found = []
    for item in data["bodies"]:
        found.append((item["name"], item))
        joint = item["joint"]
        if isinstance(joint, list):
            motions = [Joint(Motion(j["type"]), read_direction(j["axis"])) for j in joint]
            labels = label_joints(motions)
            found += [(j.get("name", f"{item['name']}.{x}"), j) for j, x in zip(joint, labels, strict=True)]
        else:
            found.append((joint.get("name", item["name"]), joint))
            made = take(joint, find_joint_type(joint["type"]))
            for label in label_joints(made.list_joints()) if isinstance(made, CompoundSection) else ():
                setting = joint.setdefault("axes", {}).setdefault(label, {})
                found.append((setting.get("name", f"{item['name']}.{label}"), setting))
    return found


def _list_turns(orientation: Any) -> Any:
    """Write a quaternion or a matrix as the turns about z, y and x that its parameters are of."""
    match orientation:
        case {"quaternion": parts}:
            turns = read_quaternion(parts)
        case {"matrix": rows}:
            turns = read_matrix(rows)
        case _:
            return orientation
    return [{"axis": "xyz"[turn.axis], "angle": write(turn.angle)} for turn in turns]


def _write(owner: Data, place: list[str], value: float) -> None:
    key, *rest = place
    match key, rest:
        case "orientation", ["roll" | "pitch" | "yaw" as angle]:
            owner["orientation"]["rpy"][("roll", "pitch", "yaw").index(angle)] = value
        case "orientation", [k]:
            owner["orientation"] = _list_turns(owner["orientation"])
            owner["orientation"][int(k) - 1]["angle"] = value
        case "inertia", ["about", axis]:
            owner["inertia"]["about"]["xyz".index(axis)] = value
        case "inertia", [entry]:
            tensor = owner.get("inertia", [0, 0, 0])
            if isinstance(tensor, list):
                tensor = dict(zip(("xx", "yy", "zz"), tensor, strict=True))
            owner["inertia"] = tensor | {entry: value}
        case "points", [k, axis]:
            owner["points"][int(k) - 1]["xyz".index(axis)] = value
        case "friction", [entry]:
            owner["friction"][entry] = value
        case _, [axis]:
            owner.setdefault(key, [0, 0, 0])["xyz".index(axis)] = value
        case _, []:
            owner[key] = value
