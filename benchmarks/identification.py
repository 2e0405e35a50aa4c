"""Identification of a Panda from made recordings: errors, times, regions: `python -m benchmarks.identification`.

Motions last 10 s. The first one is designed for all base parameters (`mbsrun excite`), with joints within 1 rad of a
pose and velocities of at most 1.5 rad/s. The second one is designed for the mass of link5 (criterion C), within the
robot's own ranges and 2.175 rad/s, with 8 harmonics; torques are weighted by the noise of the motion before, in 4
passes, and the pass with the least bound of the four masses counts. Torques follow from the model, and get white noise
with a standard deviation of 5 % of each torque's root mean square. Coordinates, velocities and accelerations are exact.
The bound of a mass is Cramér's and Rao's: no unbiased estimate from such a recording has a smaller standard deviation.
Times are processor time on one thread, of reading samples, writing rows and estimating; the kernel is compiled before.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from benchmarks.compilation import describe_machine
from benchmarks.pages import tabulate
from mbsrun.identification import Base, Identification, Settings, Wishes, excite, identify
from mbsrun.identification.equations import write_rows
from mbsrun.identification.excitation import Excitation
from mbsrun.identification.identify import prepare
from mbsrun.identification.reading import read_samples
from mbsrun.identification.structure import find_structure
from mbsrun.identification.unknowns import list_unknowns
from mbsrun.models import read_numbers
from tests.mbsrun.identification.motions import PANDA, TWO_LINK, Inside, count_inside, open_model, record, swing

Array = NDArray[np.float64]
Motion = tuple[Array, Array, Array]  # q, qd, qdd

NOISE = 0.05
RATE = 1000  # samples in a second
POSE = (0.0, 0.0, 0.0, -1.5, 0.0, 1.8, 0.0)
REACH, SPEED = 1.0, 1.5  # about the pose [rad]; of all joints [rad/s]
QUIETLY = Wishes(starts=2, step=1 / RATE, speed=SPEED)
AIM, PASSES = "link5", 4
AIMED = Wishes(starts=3, step=1 / RATE, speed=2.175, harmonics=8, criterion="C", number=f"m[{AIM}]")
RANGES = (  # of the joints [rad]: Franka Emika, "FCI Documentation"
    (-2.8973, 2.8973), (-1.7628, 1.7628), (-2.8973, 2.8973), (-3.0718, -0.0698), (-2.8973, 2.8973), (-0.0175, 3.7525),
    (-2.8973, 2.8973),
)  # fmt: skip
LINKS = ("link4", "link5", "link6", "link7")  # whose mass is determined, where all other links are known


@dataclass(frozen=True)
class Weighing:
    """The errors of a link's mass, where all other links are known, over some recordings."""

    body: str
    mass: float
    median: float  # error, relative
    largest: float
    deviation: float  # as the estimate states it, relative
    bound: float  # of deviations, relative
    count: int  # of the recordings


def main() -> None:
    """Measure, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("build/identification.md"), help="the page")
    parser.add_argument("--recordings", type=int, default=1000, help="for regions of 95 %%")
    parser.add_argument("--weighed", type=int, default=20, help="recordings for each link's mass")
    arguments = parser.parse_args()
    with TemporaryDirectory() as folder:
        motion, aimed = design_whole(Path(folder)), design_aimed(Path(folder))
    seconds, found = take_time(motion)
    weighings = {
        title: [x for link in LINKS if (x := weigh(link, own, arguments.weighed))]
        for title, own in (("all base parameters", motion), (f"the mass of {AIM}", aimed))
    }
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


def design_whole(folder: Path) -> Motion:
    """Design the motion for all base parameters."""
    return read_motion(design(folder, [(x - REACH, x + REACH) for x in POSE], Settings(), QUIETLY))


def design_aimed(folder: Path, wishes: Wishes = AIMED, passes: int = PASSES) -> Motion:
    """Design motions for the mass of a link, each by the noise of the one before; return the best."""
    noise: dict[str, float] = {}
    found: list[Motion] = []
    for _ in range(passes):
        excitation = design(folder, RANGES, Settings(bodies=(AIM,), noise=noise), wishes)
        found.append(read_motion(excitation))
        sizes = NOISE * np.sqrt((excitation.u[:-1] ** 2).mean(axis=0))
        noise = {f"panda_joint{i}": size for i, size in enumerate(sizes.tolist(), 1)}
    return min(found, key=lambda motion: max(bound(link, motion) for link in LINKS))


def design(folder: Path, ranges: Sequence[tuple[float, float]], settings: Settings, wishes: Wishes) -> Excitation:
    """Design a motion of the Panda, within ranges that are written into its model."""
    text = PANDA.read_text("utf-8")
    for i, (low, high) in enumerate(ranges, 1):
        joint = f"name: panda_joint{i}"
        lines = [line for line in text.splitlines() if line.strip().strip("{").startswith(("joint: {" + joint, joint))]
        (line,) = lines
        limits = f"limits: [{low}, {high}]"
        changed = line.replace(joint, f"{joint}, {limits}") if "{" in line else f"{line}\n      {limits}"
        text = text.replace(line, changed)
    (folder / "panda.yaml").write_text(text, "utf-8")
    return excite(folder / "panda.yaml", settings, wishes)


def read_motion(found: Excitation) -> Motion:
    """Return the coordinates of a period with their rates."""
    return found.q[:-1], found.qd[:-1], found.qdd[:-1]


def bound(body: str, motion: Motion) -> float:
    """Return the least standard deviation of a link's mass, relative, by the inverse of Fisher's information."""
    kernels, settings, numbers = open_model(PANDA), Settings(bodies=(body,)), read_numbers(PANDA, {})
    unknowns = list_unknowns(kernels.manifest, numbers, settings)
    setting = prepare(kernels, numbers, settings)
    structure, exact = find_structure(setting, unknowns), record(kernels, np.arange(len(motion[0])) / RATE, motion, 0.0)
    samples = read_samples(exact, exact, kernels, settings, ())
    rows, _ = write_rows(setting, samples, structure.unknowns, np.zeros(len(POSE)))
    own = rows[:, :, list(structure.kept)] / (NOISE * np.sqrt((samples.u**2).mean(axis=0)))[:, None]
    k = structure.names.index(f"m[{body}]")
    variance = np.linalg.inv(np.einsum("kri,krj->ij", own, own))[k, k]
    return float(np.sqrt(variance)) / structure.unknowns[structure.kept[k]].value


def thin(motion: Motion, every: int) -> Motion:
    """Keep some times of a motion."""
    q, qd, qdd = (x[::every] for x in motion)
    return q, qd, qdd


def take_time(motion: Motion) -> tuple[float, Identification]:
    """Identify all base parameters; return the least processor time of five [s]."""
    kernels, t = open_model(PANDA), np.arange(len(motion[0])) / RATE
    made, best = record(kernels, t, motion, NOISE), np.inf
    for _ in range(5):
        begun = time.process_time()
        found = identify(PANDA, [made])
        best = min(best, time.process_time() - begun)
    return best, found


def weigh(body: str, motion: Motion, count: int) -> Weighing | None:
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
    deviation = masses[0].deviation / mass
    return Weighing(body, mass, float(np.median(errors)), max(errors), deviation, bound(body, motion), count)


def write_page(
    seconds: float,
    found: Identification,
    weighings: Mapping[str, list[Weighing]],
    inside: dict[str, Inside],
    recordings: int,
) -> str:
    """Write the page."""
    masses = [
        (title, x.body, f"{x.mass:.4g}", *(f"{100 * part:.2g}" for part in (x.median, x.largest, x.deviation, x.bound)))
        for title, own in weighings.items()
        for x in own
    ]
    count = next(iter(weighings.values()))[0].count
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
            f"where the numbers of all other links are known. Each is weighed from {count} recordings.",
            "",
            *tabulate(
                (
                    "motion for",
                    "link",
                    "mass [kg]",
                    "median error [%]",
                    "largest [%]",
                    "standard deviation [%]",
                    "its bound [%]",
                ),
                masses,
                words=2,
            ),
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
