"""Where the files that are not Python lie: `templates/` and `csrc/`, in a wheel or in a checkout."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent
_CHECKOUT = _PACKAGE.parent.parent


def folder(name: str) -> Path:
    """Return the folder `name` ("templates" or "csrc"): a wheel carries it inside the package, a checkout beside it."""
    installed = _PACKAGE / name
    return installed if installed.is_dir() else _CHECKOUT / name
