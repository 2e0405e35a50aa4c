"""Modules that are loaded at their first use are the same modules."""

from __future__ import annotations

import gc
import subprocess
import sys

import pytest

from mbsgen.quick_imports import SELDOM_USED, quick_imports, without_searches

COUNT = """
import sys
from importlib import import_module
from mbsgen.quick_imports import quick_imports
name, attribute = sys.argv[1:]
with quick_imports():
    module = import_module(name)
kind = type(module).__name__
found = getattr(module, attribute)
print(kind, type(module).__name__, sys.modules[name] is module, bool(found))
"""


@pytest.mark.parametrize(
    ("name", "attribute"), [*zip(SELDOM_USED, ("get_include", "assert_allclose", "AGL2UV"), strict=True)]
)
def test_a_module_is_loaded_at_its_first_use(name: str, attribute: str) -> None:
    done = subprocess.run((sys.executable, "-c", COUNT, name, attribute), capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["_LazyModule", "module", "True", "True"]


def test_scipy_computes_while_such_modules_wait() -> None:
    code = (
        "from mbsgen.quick_imports import quick_imports\n"
        "with quick_imports():\n"
        "    from scipy import sparse\n"
        "import sys\n"
        "print(sparse.eye_array(3).sum(), type(sys.modules['numpy.f2py']).__name__)\n"
    )
    done = subprocess.run((sys.executable, "-c", code), capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["3.0", "_LazyModule"]


def test_the_list_of_finders_is_as_before_afterwards() -> None:
    before = [*sys.meta_path]
    with pytest.raises(KeyError), quick_imports():
        raise KeyError
    assert sys.meta_path == before


@pytest.mark.parametrize("is_enabled", [True, False])
def test_searches_for_cycles_are_as_before_afterwards(is_enabled: bool) -> None:
    before = gc.isenabled()
    try:
        (gc.enable if is_enabled else gc.disable)()
        with without_searches():
            assert not gc.isenabled()
        assert gc.isenabled() is is_enabled
    finally:
        (gc.enable if before else gc.disable)()
