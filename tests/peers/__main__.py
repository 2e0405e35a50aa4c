"""Install the peers: `python -m tests.peers build/peers`."""

from __future__ import annotations

import sys
from pathlib import Path

from tests.peers import make

if __name__ == "__main__":
    make(Path(sys.argv[1]).resolve())
