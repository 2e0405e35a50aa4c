"""Write the golden output in `generated/`: `python -m tests.golden`, or `make golden`.

The folder holds one generated folder whole, as a sample to read, and `SHA256SUMS` with the hash of every file that the
models of GOLDEN generate. They show that nothing changed, not that it is right. Read `git diff generated/` before a
commit. Where a hash changed, generate the model's folder before and after the change and compare the two:

    python -m tests.golden arm_pendulum build/before
"""

from __future__ import annotations

import argparse
import hashlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

from mbsgen.pipeline import Options, generate

ROOT = Path(__file__).parents[1]
GENERATED = ROOT / "generated"
SUMS = GENERATED / "SHA256SUMS"  # `sha256sum` reads it
SAMPLE = "double_pendulum"
GOLDEN: Mapping[str, Options] = {  # six_axis and quadruped take half a minute: they are left out
    "acrobot": Options(),
    "arm_pendulum": Options(),
    "branched": Options(),
    "cart_pole": Options(runtime=True, targets=("python", "matlab")),
    "double_pendulum": Options(targets=("python", "matlab")),
    "leg": Options(),
    "pendulum": Options(),
    "planar_arm": Options(),
    "satellite": Options(targets=("python",)),
}


def write_golden(name: str, out: Path) -> None:
    """Generate the folder `out` for a model of GOLDEN."""
    generate(ROOT / "models" / f"{name}.yaml", out, GOLDEN[name])


def write_in_process(names: list[str], place: Path, seed: int) -> None:
    """Generate the folders of some models below `place`, in a process with another hash seed."""
    script = "import sys; from pathlib import Path; from tests.golden import write_golden\n"
    script += "for name in sys.argv[2:]: write_golden(name, Path(sys.argv[1], name))"
    environment = {**os.environ, "PYTHONHASHSEED": str(seed)}
    subprocess.run([sys.executable, "-c", script, place, *names], cwd=ROOT, env=environment, check=True)


def hash_folder(folder: Path) -> Iterator[tuple[str, str]]:
    """Return path and SHA-256 of every file below a folder; paths begin with the folder's name."""
    for file in sorted(folder.rglob("*")):
        if file.is_file():
            yield file.relative_to(folder.parent).as_posix(), hashlib.sha256(file.read_bytes()).hexdigest()


def read_sums() -> dict[str, str]:
    """Read the committed hashes, by path."""
    lines = SUMS.read_text(encoding="utf-8").splitlines()
    return {path: digest for digest, _, path in (line.partition("  ") for line in lines)}


def write_all() -> None:
    """Replace the sample and the hashes."""
    with tempfile.TemporaryDirectory() as place:
        write_in_process(list(GOLDEN), Path(place), seed=0)
        lines = [f"{digest}  {path}" for name in GOLDEN for path, digest in hash_folder(Path(place, name))]
    SUMS.write_text("\n".join(lines) + "\n", encoding="utf-8")
    write_golden(SAMPLE, GENERATED / SAMPLE)


def main() -> None:
    """Write all golden output, or the folder of one model."""
    parser = argparse.ArgumentParser(prog="python -m tests.golden", description=__doc__.partition("\n")[0])
    parser.add_argument("model", nargs="?", choices=GOLDEN, help="generate this model alone")
    parser.add_argument("out", nargs="?", type=Path, help="to this folder")
    given = parser.parse_args()
    if given.model is None:
        write_all()
        print(f"wrote {SUMS.relative_to(ROOT)} and generated/{SAMPLE}")
    elif given.out is None:
        parser.error("a model needs a folder to write to")
    else:
        write_golden(given.model, given.out)
        print(f"wrote {given.out}")


if __name__ == "__main__":
    main()
