"""Identification of a Panda from made recordings: errors, times, regions: `python -m benchmarks.identification`.

The motion lasts 10 s, and is designed for its base parameters (`mbsrun excite`), with joints within 1 rad of a pose and
velocities of at most 1.5 rad/s. Torques follow from the model, and get white noise with a standard deviation of 5 % of
each torque's root mean square. Coordinates, velocities and accelerations are exact. Times are processor time on one
thread, of reading samples, writing rows and estimating; the kernel is compiled before.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from benchmarks.compilation import describe_machine
from benchmarks.pages import tabulate
from mbsrun.identification import Base, Identification, Settings, Wishes, excite, identify
from tests.mbsrun.identification.motions import PANDA, TWO_LINK, Inside, count_inside, open_model, record, swing

Array = NDArray[np.float64]

NOISE = 0.05
RATE = 1000  # samples in a second
POSE = (0.0, 0.0, 0.0, -1.5, 0.0, 1.8, 0.0)
REACH, SPEED = 1.0, 1.5  # about the pose [rad]; of all joints [rad/s]
QUIETLY = Wishes(starts=2, step=1 / RATE, speed=SPEED)


@dataclass(frozen=True)
class Weighing:
    """The errors of a link's mass, where all other links are known, over some recordings."""

    body: str
    mass: float
    median: float  # error, relative
    largest: float
    deviation: float  # as the estimate states it, relative
    count: int  # of the recordings


def main() -> None:
    """Measure, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("build/identification.md"), help="the page")
    parser.add_argument("--recordings", type=int, default=1000, help="for regions of 95 %%")
    parser.add_argument("--weighed", type=int, default=20, help="recordings for each link's mass")
    arguments = parser.parse_args()
    with TemporaryDirectory() as folder:
        motion = design(Path(folder))
    seconds, found = take_time(motion)
    weighings = [x for i in range(1, 8) if (x := weigh(f"link{i}", motion, arguments.weighed))]
    seeds = range(arguments.recordings)
    inside = {
        "two links, 6 base parameters, 300 samples each": count_inside(
            TWO_LINK, swing(2, np.arange(300) / 30, 3), NOISE, seeds
        ),
        "Panda, 43 base parameters, 500 samples each": count_inside(PANDA, thin(motion, 20), NOISE, seeds),
    }
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(write_page(seconds, found, weighings, inside, arguments.recordings), encoding="utf-8")
    print(f"{arguments.out} holds the figures.")


def design(folder: Path) -> tuple[Array, Array, Array]:
    """Design the motion of the Panda, within limits that are written into its model."""
    text = PANDA.read_text("utf-8")
    for i, place in enumerate(POSE, 1):
        joint = f"name: panda_joint{i}"
        lines = [line for line in text.splitlines() if line.strip().strip("{").startswith(("joint: {" + joint, joint))]
        (line,) = lines
        limits = f"limits: [{place - REACH}, {place + REACH}]"
        changed = line.replace(joint, f"{joint}, {limits}") if "{" in line else f"{line}\n      {limits}"
        text = text.replace(line, changed)
    (folder / "panda.yaml").write_text(text, "utf-8")
    found = excite(folder / "panda.yaml", Settings(), QUIETLY)
    return found.q[:-1], found.qd[:-1], found.qdd[:-1]


def thin(motion: tuple[Array, Array, Array], every: int) -> tuple[Array, Array, Array]:
    """Keep some times of a motion."""
    q, qd, qdd = (x[::every] for x in motion)
    return q, qd, qdd


def take_time(motion: tuple[Array, Array, Array]) -> tuple[float, Identification]:
    """Identify all base parameters; return the least processor time of five [s]."""
    kernels, t = open_model(PANDA), np.arange(len(motion[0])) / RATE
    made, best = record(kernels, t, motion, NOISE), np.inf
    for _ in range(5):
        begun = time.process_time()
        found = identify(PANDA, [made])
        best = min(best, time.process_time() - begun)
    return best, found


def weigh(body: str, motion: tuple[Array, Array, Array], count: int) -> Weighing | None:
    """Identify the numbers of a link beside known ones of all other links; None where no motion weighs it alone."""
    kernels, t = open_model(PANDA), np.arange(len(motion[0])) / RATE
    masses: list[Base] = []
    for seed in range(count):
        found = identify(PANDA, [record(kernels, t, motion, NOISE, seed)], Settings(bodies=(body,)))
        masses += [x for x in found.base if x.name == f"m[{body}]"]
        if not masses:
            return None
    errors = [abs(x.value / x.before - 1) for x in masses]
    mass = masses[0].before
    return Weighing(body, mass, float(np.median(errors)), max(errors), masses[0].deviation / mass, count)


def write_page(
    seconds: float, found: Identification, weighings: list[Weighing], inside: dict[str, Inside], recordings: int
) -> str:
    """Write the page."""
    masses = [
        (x.body, f"{x.mass:.4g}", f"{100 * x.median:.2g}", f"{100 * x.largest:.2g}", f"{100 * x.deviation:.2g}")
        for x in weighings
    ]
    large = [x for x in found.base if abs(x.before) > 0.1]
    sums = [
        (
            x.name,
            f"{x.before:.4g}",
            f"{100 * abs(x.value / x.before - 1):.2g}",
            f"{100 * x.deviation / abs(x.before):.2g}",
        )
        for x in large
    ]
    regions = [(name, f"{100 * x.ellipsoids:.1f}", f"{100 * x.intervals:.1f}") for name, x in inside.items()]
    heading = __doc__.partition("\n\n")[2].strip() if __doc__ else ""
    return "\n".join(
        [
            "# Identification",
            "",
            heading,
            "",
            f"All {len(found.base)} base parameters, from {RATE} Hz and {found.freedom + len(found.base)} rows, take "
            f"{seconds:.2g} s, on {describe_machine()}. The condition of their columns is {found.condition:.3g}.",
            "",
            "## Masses of links",
            "",
            "No mass is a base parameter of a Panda: masses enter sums. The table has links whose mass is determined",
            f"where the numbers of all other links are known. Each is weighed from {weighings[0].count} recordings.",
            "",
            *tabulate(("link", "mass [kg]", "median error [%]", "largest [%]", "standard deviation [%]"), masses),
            "",
            "## Base parameters above 0.1 kg m or kg m²",
            "",
            *tabulate(("sum", "value", "error of one recording [%]", "standard deviation [%]"), sums),
            "",
            "## Regions of 95 %",
            "",
            f"{recordings} recordings of one motion have different noise. The table has the part of them with the true",
            "numbers in the ellipsoid of all base parameters, and the part of the intervals that hold their number.",
            "",
            *tabulate(("mechanism", "ellipsoids [%]", "intervals [%]"), regions),
            "",
        ]
    )


if __name__ == "__main__":
    main()
