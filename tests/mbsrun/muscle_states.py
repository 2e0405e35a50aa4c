"""All kinds of muscles against OpenSim at many random states: `python -m tests.mbsrun.muscle_states 10000`.

It prints the largest differences: of De Groote's muscles by kinds of numbers, relative to the largest one or, of the
equilibrium of elastic tendons, to each number; of Millard's and Thelen's in tension and equilibrium, over the strength.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from tests.mbsrun import muscle_files, test_muscle_curves, test_muscles


def main(count: int) -> None:
    """Compare muscles at some states."""
    states = test_muscles.draw(count)
    for key, miss in test_muscles.find_misses(states, test_muscles.ask_opensim(states)).items():
        print(f"De Groote, {key}: {miss:.1e}")
    drawn = muscle_files.draw(count)
    with tempfile.TemporaryDirectory() as folder:
        misses = test_muscle_curves.find_misses(Path(folder), drawn, muscle_files.ask_opensim(drawn))
    for name, (tension, equilibrium) in zip(muscle_files.MUSCLES, misses.tolist(), strict=True):
        kind, is_rigid, *_ = muscle_files.MUSCLES[name]
        print(f"{kind}, {name}: tension {tension:.1e}" + ("" if is_rigid else f", equilibrium {equilibrium:.1e}"))


if __name__ == "__main__":
    main(int(sys.argv[1]))
