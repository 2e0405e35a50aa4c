"""Commands of the folder `studies`, which is beside the package in a checkout, and within an installed package."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

HERE = Path(__file__).resolve()
PLACES = HERE.parents[3], HERE.parents[1] / "sources"  # in a checkout or an editable install; in an installed package


def run_study(folder: str, name: str, arguments: Sequence[str]) -> None:
    """Run the command `mbsrun NAME`, which a folder of the studies holds as `command.NAME_command`."""
    place = next(place for place in PLACES if (place / "studies" / folder / "command.py").is_file())
    if str(place) not in sys.path:
        sys.path.append(str(place))
    command = getattr(import_module(f"studies.{folder}.command"), f"{name}_command")
    command.main(args=[*arguments], prog_name=f"mbsrun {name}")
