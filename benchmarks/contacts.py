"""A humanoid on two feet, beside MuJoCo at equal steps: `python -m benchmarks.contacts`.

The humanoid is the one of MuJoCo's package, with 27 degrees of freedom and the ends of four capsules as eight points of
contact. Springs of 500 N m/rad and dampers of 10 N m s/rad hold its joints; it has no actuators, limits or tendons. It
stands at the start, or falls from 2 cm. Here contacts are rigid, there they give way, as its file says. Times are
processor time of one thread, the least of some runs, one after the other: this program's with all records of the steps,
MuJoCo's of steps alone.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

import mbsrun
from benchmarks.compilation import describe_machine
from benchmarks.pages import tabulate
from mbsgen.importing import Choices, import_model
from mbsgen.model.construction import contact
from mbsgen.model.model import Model
from mbsgen.model.writer import write_model
from mbsrun.models import Extent
from mbsrun.simulation import Motion, Settings, simulate
from mbsrun.simulation.drive import hold

Array = NDArray[np.float64]

FILE = "mjx/test_data/humanoid/humanoid.xml"
STIFFNESS, DAMPING = 500.0, 10.0
DURATION, STEP, RUNS = 2.0, 1e-3, 5
LIFTS = (0.0, 0.02)  # above the ground [m]
FRICTION = 0.7
FUNCTIONS = ("impl", "exp2", "touching", "distances", "energy", "power", "frames")


@dataclass(frozen=True)
class Run:
    """One motion by one program."""

    lift: float  # [m]
    program: str
    step: float  # microseconds of processor time
    residual: float | None  # of the cone problems, the largest
    depth: float  # of the deepest point at the end [m]
    creep: float  # of the fastest point at the end, along the ground [m/s]


def main() -> None:
    """Measure, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("build/contacts.md"), help="the page")
    out = parser.parse_args().out
    with TemporaryDirectory() as folder:
        runs = measure(Path(folder))
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(write_page(runs), encoding="utf-8")
    print(f"wrote {out}")


def measure(folder: Path, duration: float = DURATION, times: int = RUNS) -> list[Run]:
    """Simulate the humanoid by both programs."""
    file = folder / "humanoid.xml"
    peer = prepare(file)
    ours = mbsrun.load(build(file, peer, folder), extent=Extent(FUNCTIONS, 1))
    return [
        run
        for lift in LIFTS
        for run in (step_here(ours, peer, lift, duration, times), step_there(peer, lift, duration, times))
    ]


def prepare(file: Path) -> Any:
    """Write the humanoid with springs and dampers in its joints, and return MuJoCo's model of it."""
    spec = mujoco.MjSpec.from_file(str(Path(mujoco.__file__).parent / FILE))
    for joint in spec.joints:
        if joint.type != mujoco.mjtJoint.mjJNT_FREE:
            joint.stiffness, joint.damping = (
                _spread(x, at) for x, at in ((STIFFNESS, joint.stiffness), (DAMPING, joint.damping))
            )
            joint.limited, joint.frictionloss = 0, 0
    for parts in (spec.actuators, spec.tendons, spec.keys):
        for part in list(parts):
            spec.delete(part)
    spec.option.timestep, spec.option.iterations, spec.option.ls_iterations = STEP, 100, 50
    model = spec.compile()
    file.write_text(spec.to_xml(), encoding="utf-8")
    return model


def _spread(value: float, like: Any) -> Any:
    """Return a coefficient as this version of MuJoCo holds it: a number, or a polynomial of which it is the first."""
    if np.ndim(like) == 0:
        return value
    return np.concatenate(([value], np.zeros(np.size(like) - 1)))


def build(file: Path, peer: Any, folder: Path) -> Path:
    """Write the same humanoid as a model, with the ends of its feet's capsules as rigid points."""
    model = import_model(file, Choices(name="humanoid", quarter_turns=0.0, mimic="free")).model
    bare = folder / "bare.yaml"
    bare.write_text(write_model(model), encoding="utf-8")
    frames = mbsrun.load(bare, extent=Extent(("frames",), 0))
    out = folder / "humanoid.yaml"
    out.write_text(write_model(add_feet(model, frames, peer)), encoding="utf-8")
    return out


def add_feet(model: Model, frames: mbsrun.Mechanism, peer: Any) -> Model:
    """Add the contacts: places of MuJoCo's points, in the frames of this program's bodies."""
    data, contacts = mujoco.MjData(peer), []
    mujoco.mj_forward(peer, data)
    poses = frames("frames", q=start(frames, data.qpos[2]))
    names = [frame.name for frame in frames.manifest.frames]
    for geom in list_feet(peer):
        body = peer.body(peer.geom_bodyid[geom]).name
        i = max(k for k, name in enumerate(names) if name == body or name.startswith(f"{body}."))
        for k, place in enumerate(find_ends(peer, data, geom)):
            position = poses["R"][:, 3 * i : 3 * i + 3].T @ (place - poses["p"][:, i])
            name, radius = f"{peer.geom(geom).name}_{k}", float(peer.geom_size[geom, 0])
            place_here = tuple(map(float, position))
            contacts.append(contact(name, body, position=place_here, radius=radius, restitution=0.0, friction=FRICTION))
    return replace(model, contacts=tuple(contacts))


def list_feet(peer: Any) -> list[int]:
    """List the capsules of the feet."""
    return [k for k in range(peer.ngeom) if "foot" in peer.geom(k).name]


def find_ends(peer: Any, data: Any, geom: int) -> list[Array]:
    """Return the centres of both ends of a capsule."""
    axis = data.geom_xmat[geom].reshape(3, 3)[:, 2] * peer.geom_size[geom, 1]
    return [data.geom_xpos[geom] + side * axis for side in (-1, 1)]


def start(kernels: mbsrun.Mechanism, height: float) -> Array:
    """Return the pose of a humanoid that stands at a height [m]."""
    q = np.zeros(len(kernels.manifest.positions))
    q[2] = height
    return q


def step_here(kernels: mbsrun.Mechanism, peer: Any, lift: float, duration: float, times: int) -> Run:
    """Simulate by time stepping with rigid contacts."""
    q, n = start(kernels, float(peer.qpos0[2]) + lift), len(kernels.manifest.coordinates)
    drive = hold([0.0] * len(kernels.manifest.inputs))
    settings = Settings(duration, "moreau", step=STEP, output_step=duration / 20)
    motions: list[Motion] = [simulate(kernels, drive, q, np.zeros(n), settings) for _ in range(times)]
    last = motions[-1]
    assert last.is_complete
    touching = kernels("touching", q=last.q[-1])
    speeds = (touching["slide"] @ last.qd[-1]).reshape(-1, 3)
    least = min(motion.effort.seconds / motion.effort.steps for motion in motions)
    depth, creep = -float(touching["clearance"].min()), float(np.linalg.norm(speeds[:, :2], axis=1).max())
    return Run(lift, "mbsrun", 1e6 * least, last.effort.residual, depth, creep)


def step_there(peer: Any, lift: float, duration: float, times: int) -> Run:
    """Simulate by MuJoCo."""
    steps, least = round(duration / STEP), np.inf
    for _ in range(times):
        data = mujoco.MjData(peer)
        data.qpos[2] += lift
        before = time.process_time()
        for _ in range(steps):
            mujoco.mj_step(peer, data)
        least = min(least, (time.process_time() - before) / steps)
    mujoco.mj_forward(peer, data)
    depth, creep = -np.inf, 0.0
    for geom in list_feet(peer):
        J = np.zeros((3, peer.nv))
        for place in find_ends(peer, data, geom):
            touched = place - [0, 0, peer.geom_size[geom, 0]]
            mujoco.mj_jac(peer, data, J, None, touched, peer.geom_bodyid[geom])
            depth = max(depth, -float(touched[2]))
            creep = max(creep, float(np.linalg.norm((J @ data.qvel)[:2])))
    return Run(lift, f"MuJoCo {mujoco.__version__}", 1e6 * float(least), None, depth, creep)


def write_page(runs: list[Run]) -> str:
    """Write the page."""
    titles = ["start", "program", "µs a step", "times real time", "residual", "depth [m]", "slip [m/s]"]
    rows = [
        [
            "stands" if run.lift == 0 else f"falls {100 * run.lift:g} cm",
            run.program,
            f"{run.step:.3g}",
            f"{1e6 * STEP / run.step:.3g}",
            "–" if run.residual is None else f"{run.residual:.1e}",
            f"{run.depth:.1e}",
            f"{run.creep:.1e}",
        ]
        for run in runs
    ]
    about = (__doc__ or "").split("\n\n", 1)[1].strip()
    lines = [
        "# Rigid contacts",
        "",
        about,
        "",
        f"{DURATION:g} s with steps of {1e3 * STEP:g} ms, on {describe_machine()}.",
    ]
    lines += [
        "Residuals are relative, as in `csrc/mbs_cone.h`; depth and slip are of the worst point at the end.",
        "",
    ]
    return "\n".join([*lines, *tabulate(titles, rows, words=2), ""])


if __name__ == "__main__":
    main()
