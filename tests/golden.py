"""Golden output: `python -m tests.golden` writes `generated/` anew, for the models listed here.

It shows that nothing changed, or what did: `git diff generated/` is to be read before it is committed.
"""

from __future__ import annotations

from pathlib import Path

from mbsgen.pipeline import Options, generate

ROOT = Path(__file__).parents[1]
GOLDEN: dict[str, Options] = {
    "arm_pendulum": Options(),
    "cart_pole": Options(runtime=True, python=True, matlab=True),
    "double_pendulum": Options(python=True),
}


def write_golden(name: str, out: Path) -> None:
    """Generate the folder `out` for a model of the list."""
    generate(ROOT / "models" / f"{name}.yaml", out, GOLDEN[name])


def main() -> None:
    """Replace every folder of `generated/`."""
    for name in GOLDEN:
        out = ROOT / "generated" / name
        write_golden(name, out)
        print(f"wrote {out.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
