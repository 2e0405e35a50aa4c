"""The list of planted faults fits the source: each text stands once in its file, and its tests exist."""

from __future__ import annotations

import pytest

from tests.mutants.faults import GOLDEN, ROOT, Fault, read_faults


@pytest.mark.parametrize("fault", read_faults(), ids=lambda fault: fault.name)
def test_a_fault_can_be_planted(fault: Fault) -> None:
    text = (ROOT / fault.file).read_text("utf-8")
    assert text.count(fault.find) == 1
    assert fault.find != fault.replace
    assert fault.tests
    for test in fault.tests:
        assert test != GOLDEN
        assert (ROOT / test.partition("::")[0]).exists()
