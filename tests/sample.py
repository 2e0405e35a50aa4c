"""A small model made of tapes alone: the ground of the tests of generated code.

`f(x, y)` and `g(x, y)` use every operation; g is a sparse matrix. The input `z` is differentiable but not used, `u` has
no entry, and `h` is what `setup` makes of two run-time parameters.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from mbsgen import manifest
from mbsgen.derivatives.kernels import differentiate
from mbsgen.formulations import ports
from mbsgen.manifest import Coordinate, Frame, Manifest, Parameter
from mbsgen.tape.builder import Builder
from mbsgen.tape.types import Sparsity, Tape
from mbsgen.targets.c.files import Sources, write_c
from mbsgen.targets.contract import Family
from mbsgen.targets.names import mangle
from mbsgen.targets.parts import LENGTH
from mbsgen.targets.unit import Unit

DIFFERENTIATED = ("x", "y", "u", "z")
PARAMETERS = {"length": 0.7, "m-4": 2.5}


def sample_tape(name: str = "impl", *, parametric: bool = True) -> Tape:
    """Write f (3 x 1) and g (2 x 2, three nonzeros) of x (3), y (2), u (0), z (1) and, if parametric, h (2)."""
    b = Builder()
    x, y = b.vector("x", 3), b.vector("y", 2)
    b.vector("u", 0)
    b.vector("z", 1)
    h = b.vector(ports.SETUP, 2) if parametric else [b.number(1.75), b.number(0.7)]
    sine, root = b.sin(x[0] * y[0]), b.sqrt(x[1] * x[1] + b.number(0.1) * h[0])
    b.label([sine, root], ["S1", "r"])
    b.output_dense("f", [[sine * x[2] - root / y[1]], [b.cos(x[0]) * root - x[1] * (x[2] * y[1])], [-x[2] * h[1]]])
    pattern = Sparsity.of(2, 2, [(0, 0), (1, 0), (1, 1)])
    b.output("g", pattern, [x[0] * x[0], y[1] / (x[1] * x[1] + b.number(1.0)), y[0]])
    return b.build(name)


def setup_tape() -> Tape:
    """Write h = (p0 p1, p0)."""
    b = Builder()
    p = b.vector(ports.PARAMETERS, 2)
    b.output_dense(ports.SETUP, [[p[0] * p[1]], [p[0]]])
    return b.build("setup")


def family(tape: Tape) -> Family:
    """Put the derivatives by all inputs but h beside a tape."""
    found = differentiate(tape, [name for name in DIFFERENTIATED if any(i.name == name for i in tape.inputs)])
    return Family(tape, found.jac, found.adj1, found.jac_adj1)


def sample_families(*, parametric: bool = True) -> tuple[Family, ...]:
    """Return the families of the sample model."""
    own = family(sample_tape(parametric=parametric))
    return (Family(setup_tape()), own) if parametric else (own,)


def write_sample(
    folder: Path,
    name: str = "sample",
    families: tuple[Family, ...] | None = None,
    parameters: Mapping[str, float] = MappingProxyType(PARAMETERS),
    part: int = LENGTH,
) -> Path:
    """Write a model's C and its manifest into a folder, as the pipeline does; return the folder."""
    families = sample_families() if families is None else families
    values = tuple(parameters.values()) if any(f.value.name == "setup" for f in families) else ()
    unit = Unit(mangle(name), "1.2.3", "0123abcd", families, values, part=part)
    sources = write_c(unit)
    folder.mkdir(parents=True, exist_ok=True)
    for file, text in sources.files.items():
        (folder / file).write_text(text, encoding="utf-8")
    text = describe(name, unit, sources, parameters).model_dump_json(indent=2)
    (folder / manifest.FILE_NAME).write_text(text, encoding="utf-8")
    return folder


def describe(name: str, unit: Unit, sources: Sources, parameters: Mapping[str, float]) -> Manifest:
    """Make the manifest of the sample: three joints, and the parameters if there is a `setup`."""
    parametric = any(kernel.name == "setup" for kernel in sources.kernels)
    return Manifest(
        format=manifest.FORMAT,
        generator="mbsgen",
        model=name,
        prefix=unit.prefix,
        model_hash=unit.model_hash,
        header=sources.header,
        sources=sources.sources,
        coordinates=tuple(
            Coordinate(name=f"joint {i}", motion="revolute", actuated=True, lower=None, upper=None) for i in range(3)
        ),
        parameters=tuple(Parameter(name=n, value=v) for n, v in parameters.items()) if parametric else (),
        frames=(Frame(name="b1", parent=-1, sensor=False),),
        kernels=sources.kernels,
    )
