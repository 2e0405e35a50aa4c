"""A controller on a bare Cortex-M7, in single precision: statuses, instructions, memory, as QEMU shows them.

A program solves the controller's problem, then controls its own model for some sampling periods. Where the model has
closed loops, or the problem adds states or delays, the plan is the prediction.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from mbsrun import bare
from mbsrun.controllers import folder as folders
from mbsrun.controllers.loading import read_statuses

PERIODS = 10
SECONDS = 120.0  # of the host, for all of it
FLAGS = ("-DMBS_STAGES_FLOAT",)


@dataclass(frozen=True)
class Count:
    """Instructions of a call that is made in every period."""

    usual: int  # the median
    most: int


@dataclass(frozen=True)
class Emulation:
    """The course of a controller on the emulated processor."""

    status: str  # of the solve
    iterations: int
    cost: float
    inputs: tuple[tuple[float, ...], ...]  # of each period
    steps: tuple[str, ...]  # statuses of all periods
    solve: int  # instructions
    prepare: Count
    feedback: Count
    workspace: int  # bytes
    code: int  # bytes of instructions and constants, with the C library
    stack: int  # bytes
    needs: tuple[str, ...]  # functions of the C library and of the compiler's own


def emulate(place: Path, manifest: folders.Manifest, workspace: int) -> Emulation:
    """Compile a controller's folder for the processor, and run it; `workspace` are enough bytes of memory.

    Raises BareError without the tools, or where the program does not end as it must.
    """
    from mbsgen.targets.layout import lay_out

    with tempfile.TemporaryDirectory() as building:
        main = Path(building, "main.c")
        text = lay_out(
            "controller/bare.c",
            name=manifest.prefix,
            predicts=manifest.predicts and not manifest.delays,
            bytes=workspace,
            periods=PERIODS,
        )
        main.write_text(text, encoding="utf-8")
        sources = [place / source for source in manifest.sources]
        made = bare.compile_object(sources, Path(building, "controller.o"), FLAGS)
        needs = bare.find_needs(made)
        image = bare.build([main, made], Path(building, "image.elf"), [*FLAGS, f"-I{place}"])
        outcome = bare.run(image.path, SECONDS)
    if outcome.status:
        raise bare.BareError(f"{manifest.prefix} ended with status {outcome.status} on {bare.EMULATOR}")
    return _read(manifest, image, outcome, needs, read_statuses(place))


def _read(
    manifest: folders.Manifest, image: bare.Image, outcome: bare.Outcome, needs: frozenset[str], words: Sequence[str]
) -> Emulation:
    def one(name: str) -> float:
        (number,) = outcome.numbers(name)
        return number

    inputs, size = outcome.numbers("input"), len(manifest.inputs)
    return Emulation(
        status=words[int(one("status"))],
        iterations=int(one("iterations")),
        cost=one("cost"),
        inputs=tuple(tuple(inputs[k * size : (k + 1) * size]) for k in range(PERIODS)),
        steps=tuple(words[int(x)] for x in outcome.numbers("step")),
        solve=int(one("solve")),
        prepare=_count(outcome.numbers("prepare")),
        feedback=_count(outcome.numbers("feedback")),
        workspace=int(one("bytes")),
        code=image.code,
        stack=outcome.stack,
        needs=tuple(sorted(needs)),
    )


def _count(numbers: Sequence[float]) -> Count:
    return Count(int(median(numbers)), int(max(numbers)))
