"""Options that methods share with IPOPT: values that a problem may give are values that IPOPT documents for them."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import dataclass
from functools import cache

import pytest

from mbsrun.ocp.methods import METHODS, Amount
from mbsrun.ocp.methods.options import Choice

PRINT = """
import casadi as ca
x = ca.SX.sym("x")
options = {"print_options_documentation": "yes", "print_advanced_options": "yes", "print_level": 3}
ca.nlpsol("s", "ipopt", {"x": x, "f": x**2}, {"ipopt": options, "print_time": 0})(x0=1)
"""
NUMBER = r"[-+]?(?:\d[\d.]*(?:e[-+]\d+)?|inf)"
AMOUNT = re.compile(rf"^(\w+) +({NUMBER}) +(<=?) +\( *({NUMBER})\) +(<=?) +({NUMBER}) *$", re.MULTILINE)
CHOICE = re.compile(r'^(\w+) +\("([^"]+)"\)\n(?:   .*\n|\n)*?   Possible values:\n((?:    .*\n)+)', re.MULTILINE)
WIDER = {("mbs", "watchdog_trial_iter_max")}  # from 0 on, which ends at the first trial
OTHER_DEFAULTS = {"max_wall_time"}  # 1e20 s: no limit


@dataclass(frozen=True)
class Range:
    least: float
    most: float
    default: float
    is_open: tuple[bool, bool]

    def admits(self, value: float) -> bool:
        above = value > self.least if self.is_open[0] else value >= self.least
        return above and (value < self.most if self.is_open[1] else value <= self.most)


@cache
def documentation() -> str:
    done = subprocess.run([sys.executable, "-c", PRINT], capture_output=True, text=True, check=True)
    return done.stdout


@cache
def ranges() -> dict[str, Range]:
    return {
        name: Range(float(least), float(most), float(default), (low == "<", high == "<"))
        for name, least, low, default, high, most in AMOUNT.findall(documentation())
    }


def list_shared(method: str) -> list[str]:
    return [name for name, option in METHODS[method].options.items() if isinstance(option, Amount) and name in ranges()]


@pytest.mark.parametrize("method", ["ipopt", "mbs"])
def test_ranges_are_within_the_documented_ones(method: str) -> None:
    """The project's own method also takes the ends of intervals that IPOPT states as open."""
    shared = list_shared(method)
    assert len(shared) > 20
    for name in shared:
        option, documented = METHODS[method].options[name], ranges()[name]
        assert isinstance(option, Amount)
        least = 0 if (method, name) in WIDER else documented.least
        assert least <= option.least < option.most <= documented.most, name
        if method == "ipopt":
            assert documented.admits(option.least), name
            assert documented.admits(option.most), name


@pytest.mark.parametrize("method", ["ipopt", "mbs"])
def test_the_documented_default_may_be_given(method: str) -> None:
    for name in list_shared(method):
        if name not in OTHER_DEFAULTS:
            assert METHODS[method].options[name].admits(ranges()[name].default), name


def test_words_are_documented_ones() -> None:
    found = CHOICE.findall(documentation())
    known = {name: (default, re.findall(r"^    - (\S+)", text, re.MULTILINE)) for name, default, text in found}
    options = {name: x for name, x in METHODS["ipopt"].options.items() if isinstance(x, Choice) and name in known}
    assert len(options) > 5
    for name, option in options.items():
        default, words = known[name]
        assert {*option.words} <= {*words, "mbs"}, name  # the project's own linear solver
        assert option.admits(default), name
