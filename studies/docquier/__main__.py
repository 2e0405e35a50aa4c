"""The entry point of `python -m studies.docquier`."""

from __future__ import annotations

from studies.docquier.command import main

if __name__ == "__main__":  # processes that are spawned import this module
    main()
