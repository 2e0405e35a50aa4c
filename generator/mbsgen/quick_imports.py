"""Quick imports: without searches for cycles, and without modules that libraries import for other users."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import LazyLoader
from types import ModuleType

SELDOM_USED = (
    *("numpy.f2py", "numpy.testing"),  # SciPy takes all names of NumPy, these included
    "fontTools.agl",  # names of glyphs in TeX's fonts, for Matplotlib
)


@contextmanager
def quick_imports() -> Iterator[None]:
    """Load modules of SELDOM_USED that are imported within the context at their first use, then or later."""
    finder = _Finder()
    sys.meta_path.insert(0, finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)


@contextmanager
def without_searches() -> Iterator[None]:
    """Do not search for cycles of objects: modules, and what is made of them, have many objects and few cycles."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


class _Finder:
    """A finder of modules that finds what Python finds, for modules of SELDOM_USED."""

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Find a module to be loaded later; None for any other."""
        spec = PathFinder.find_spec(name, path, target) if name in SELDOM_USED else None
        if spec is not None and spec.loader is not None:
            spec.loader = LazyLoader(spec.loader)
        return spec
