"""Modules that tests import at their first use: each process that collects tests would import PyTorch for seconds."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any

import pytest


class Late:
    """A module that is imported when something of it is used."""

    def __init__(self, name: str) -> None:
        """Name the module."""
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        """Return what the module has by this name; pytest asks every name of a file for marks."""
        if attribute.startswith("_"):
            raise AttributeError(attribute)
        return getattr(import_module(self._name), attribute)


def find(name: str, needs: str) -> Any:
    """Return a module that is imported late; skip a whole file of tests where the package that it needs is missing."""
    if find_spec(needs) is None:
        pytest.skip(f"needs {needs}", allow_module_level=True)
    return Late(name)
