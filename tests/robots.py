"""Published robots, imported, against Pinocchio and MuJoCo: `python -m tests.robots [NAME ...]`, some minutes for all.

Their packages are large, so no test needs them: `pip install -e '.[robots]'`. Packages that are not installed are
skipped, with a message; a robot whose equations differ by more than TOLERANCE makes the exit code 1. Angles are used as
in the files: rounded to quarter turns, UR5's angles of eleven digits would make differences of 5e-12.
"""

from __future__ import annotations

import importlib.util
import sys
import time
from collections.abc import Mapping
from contextlib import chdir
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from mbsgen.importing import Choices, import_model
from tests.import_peers import Kernels, MujocoPeer, PinocchioPeer, largest_miss

TOLERANCE = 1e-11
ALL = ("impl", "semi", "exp2")
LARGE = 40  # with this many joints, derivatives take too long for a look


@dataclass(frozen=True)
class Robot:
    """A file in a package."""

    file: str
    choices: Choices

    def find(self) -> Path | None:
        """Find the file, if its package is installed."""
        if self.file.endswith(".urdf"):
            folders = (Path(entry) / "cmeel.prefix/share/example-robot-data/robots" for entry in sys.path)
        else:
            spec = importlib.util.find_spec("dm_control")
            folders = map(Path, (spec and spec.submodule_search_locations) or ())
        return next((folder / self.file for folder in folders if (folder / self.file).is_file()), None)


STANDING = Choices(quarter_turns=0.0, mimic="free")
FREE = Choices(base="floating", quarter_turns=0.0, mimic="free")
ROBOTS = {
    "ur5": Robot("ur_description/urdf/ur5_robot.urdf", STANDING),
    "panda": Robot("panda_description/urdf/panda.urdf", STANDING),
    "solo12": Robot("solo_description/robots/solo12.urdf", FREE),
    "anymal": Robot("anymal_b_simple_description/robots/anymal.urdf", FREE),
    "go1": Robot("go1_description/urdf/go1.urdf", FREE),
    "talos": Robot("talos_data/robots/talos_reduced.urdf", FREE),
    "humanoid": Robot("suite/humanoid.xml", STANDING),
    "quadruped": Robot("suite/quadruped.xml", STANDING),
    "cheetah": Robot("suite/cheetah.xml", STANDING),
    "ant": Robot("third_party/ant/ant.xml", STANDING),
    "manipulator": Robot("suite/manipulator.xml", STANDING),
    "humanoid_CMU": Robot("suite/humanoid_CMU.xml", STANDING),
}


def compare(path: Path, choices: Choices) -> tuple[int, int, Mapping[str, float]]:
    """Return the joints and warnings of an imported robot, and the largest difference of each result."""
    imported = import_model(path, choices)
    size = sum(len(body.joints) for body in imported.model.bodies)
    is_urdf = path.suffix == ".urdf"
    kernels = Kernels(imported, ALL, derivatives=int(is_urdf and size < LARGE))
    floating = choices.base == "floating"
    peer = PinocchioPeer(path, kernels.joints, floating=floating) if is_urdf else MujocoPeer(path)
    misses = [largest_miss(kernels.compute(state), peer.compute(state)) for state in kernels.draw_states()]
    worst = {name: max(miss[name] for miss in misses) for name in sorted(misses[0])}
    return size, sum(notice.alters for notice in imported.notices), worst


def main(names: list[str]) -> int:
    """Compare robots, all of them by default, and print a line for each."""
    differing = 0
    for name in names or ROBOTS:
        path = ROBOTS[name].find()
        if path is None:
            print(f"{name:14}skipped: the package with {ROBOTS[name].file} is not installed")
            continue
        start = time.perf_counter()
        with TemporaryDirectory() as folder, chdir(folder):  # MuJoCo logs what it warns of where it runs
            size, warnings, worst = compare(path.resolve(), ROBOTS[name].choices)
        differing += max(worst.values()) > TOLERANCE
        figures = "  ".join(f"{result} {miss:.0e}" for result, miss in worst.items())
        print(
            f"{name:14}{size} joints, {warnings} warnings, {time.perf_counter() - start:.0f} s: {figures}", flush=True
        )
    return int(differing > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
