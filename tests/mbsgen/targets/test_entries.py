"""Names in the header: every entry of every vector has its own, in the manifest's order; full matrices."""

from __future__ import annotations

import ctypes
import re
import unicodedata
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbsgen import manifest
from mbsgen.pipeline import Options, generate
from mbsgen.targets.entries import identify, write_string
from tests.mbsgen.targets.compilation import STRICT, Requires, run

MODEL = """\
name: "two words"
gravity: [0, 0, -9.81]
parameters:
  load: {value: 2, kind: runtime}
  reach: {value: 0.3, kind: differentiated}
bodies:
  - {name: "a b", joint: {type: ball}, mass: load, com: [0.1, 0, 0], inertia: [1, 1, 1]}
  - {name: "a?\\"-b", parent: a b, joint: {name: m, type: revolute, axis: z, actuated: false}, mass: 1,
     com: [reach, 0, 0]}
  - {name: hand, parent: a b, joint: {name: "機械", type: prismatic, axis: x}, mass: 1}
frames:
  - {name: tip, body: hand}
wrenches:
  - {name: push, body: hand, force: input, moment: input}
"""
EXPECTED = {
    "q": ("a b.qx", "a b.qy", "a b.qz", "a b.qw", "m", "機械"),
    "qd": ("a b.rx", "a b.ry", "a b.rz", "m", "機械"),
    "u": ("a b.rx", "a b.ry", "a b.rz", "機械"),
    "w": tuple(f"push.{kind}.{axis}" for kind in ("force", "moment") for axis in "xyz"),
    "p": ("load",),
    "theta": ("reach",),
    "sensor": ("tip",),
    "body": ("a b.rx.to", "a b.ry.to", "a b", 'a?"-b', "hand"),
}


@given(st.lists(st.text(st.characters(exclude_categories=["Cs"]), min_size=1), unique=True))
def test_different_names_have_different_identifiers(names: list[str]) -> None:
    found = identify(names)
    assert len(set(found)) == len(names)
    assert all(re.fullmatch("[A-Za-z0-9_]+", identifier) for identifier in found)


def test_a_plain_name_stays_as_it_is() -> None:
    assert identify(["m", "left hip", "trunk.rx", "1st"]) == ["m", "left_hip", "trunk_rx", "1st"]
    assert identify(["left hip", "left.hip"]) == ["leftZ20zhip", "leftZ2ezhip"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("entries")
    (place / "model.yaml").write_text(MODEL, encoding="utf-8")
    out = place / "out"
    generate(place / "model.yaml", out, Options(functions=("impl", "semi", "frames", "jacobian"), derivatives=1))
    return out


def test_the_tables_and_enumerators_name_every_entry(folder: Path, requires: Requires) -> None:
    """Each enumerator is compiled, and printed with the name at its place; the header alone stays free of warnings."""
    described = manifest.read(folder / manifest.FILE_NAME)
    prefix, header = described.prefix, (folder / described.header).read_text()
    entries = re.findall(rf"{prefix}_IDX_([a-z]+)_(\w+) = (\d+)", header)
    lines = "".join(
        f'    printf("{group} %d %d %s\\n", {prefix}_NUM_{group}, '
        f"{prefix}_IDX_{group}_{name}, {prefix}_NAMES_{group}[{k}]);\n"
        for group, name, k in entries
    )
    program = folder.parent / "program.c"
    program.write_text(
        f'#include <stdio.h>\n#include "{described.header}"\nint main(void)\n{{\n{lines}    return 0;\n}}\n'
    )
    command = [
        requires("gcc"),
        *STRICT,
        f"-I{folder}",
        program,
        folder / f"{prefix}_names.c",
        "-o",
        program.with_suffix(""),
    ]
    run(*command)
    found: dict[str, list[str]] = {}
    for line in run(program.with_suffix("")).splitlines():
        group, size, k, name = line.split(" ", 3)
        assert int(k) == len(found.setdefault(group, []))
        assert int(size) == len(EXPECTED[group])
        found[group].append(name)
    assert {group: len(names) for group, names in found.items()} == {g: len(names) for g, names in EXPECTED.items()}
    assert found["q"] == list(described.positions)
    assert found["qd"] == [c.name for c in described.coordinates]
    assert found["u"] == [described.coordinates[i].name for i in described.actuated]
    assert found["p"] == [p.name for p in described.parameters]
    assert found["theta"] == [p.name for p in described.design]
    assert found["body"] + found["sensor"] == [frame.name for frame in described.frames]
    assert found["w"] == list(EXPECTED["w"])


@given(st.text(st.characters(exclude_categories=["Cs"])))
def test_strings_hold_any_text(text: str) -> None:
    written = write_string(text)
    assert re.fullmatch(r'"(?:[ -~])*"', written)
    octets = re.sub(rb"\\(\d{3})", lambda m: bytes([int(m[1], 8)]), written[1:-1].encode())
    assert octets.decode() == text
    assert not any(unicodedata.category(c) == "Cc" for c in written)


@pytest.mark.parametrize("order", ["rows", "columns"])
def test_full_matrices_in_c_are_those_of_numpy(order: str, folder: Path, tmp_path: Path, requires: Requires) -> None:
    """Every matrix of the folder, of arbitrary nonzeros, as the header's macro places them."""
    described = manifest.read(folder / manifest.FILE_NAME)
    header = (folder / described.header).read_text()
    matrices = {
        f"{described.prefix}_{kernel.name}_PATTERN_{a.name}": a
        for kernel in described.kernels
        for a in kernel.outputs
        if a.nnz and (a.cols != 1 or a.row is not None)
    }
    assert matrices.keys() == set(re.findall(r"#define (\w+_PATTERN_\w+)", header))
    assert any(a.row is not None for a in matrices.values())
    program = tmp_path / "fill.c"
    program.write_text(
        f'#include "{described.header}"\n'
        + "".join(
            f"void fill{k}(const double *nz, double *A);\n"
            f"void fill{k}(const double *nz, double *A)\n{{\n    mbs_fill_{order}({name}, nz, A);\n}}\n"
            for k, name in enumerate(matrices)
        )
    )
    kernels = [folder / name for kernel in described.kernels for name in kernel.sources]
    options = [*STRICT, f"-I{folder}", "-O1", "-fPIC", "-shared", "-fsanitize=undefined", "-fno-sanitize-recover"]
    run(requires("gcc"), *options, program, *kernels, "-lm", "-o", tmp_path / "fill.so")
    library = ctypes.CDLL(str(tmp_path / "fill.so"))
    pointer = ctypes.POINTER(ctypes.c_double)
    for k, a in enumerate(matrices.values()):
        nonzeros, found = (
            np.arange(1.0, a.nnz + 1),
            np.full((a.rows, a.cols), np.nan, order="C" if order == "rows" else "F"),
        )
        getattr(library, f"fill{k}")(nonzeros.ctypes.data_as(pointer), found.ctypes.data_as(pointer))
        expected = np.zeros((a.rows, a.cols))
        for c in range(a.cols):
            for n in range(c * a.rows, (c + 1) * a.rows) if a.colind is None else range(*a.colind[c : c + 2]):
                expected[n - c * a.rows if a.row is None else a.row[n], c] = nonzeros[n]
        np.testing.assert_array_equal(found, expected)
