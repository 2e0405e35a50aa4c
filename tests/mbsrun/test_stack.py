"""The largest stack: chains of known graphs, and of a small program that GCC compiles."""

from __future__ import annotations

from pathlib import Path

import pytest

from mbsrun.stack import Chain, Function, Rules, StackError, find_deepest, read_graphs
from tests.graphs import compile_graphs
from tests.mbsgen.targets.compilation import Requires

GRAPH = r"""graph: { title: "/a/b/one.c"
node: { title: "/a/b/one.c:part" label: "part\n/a/b/one.c:3:12\n24 bytes (static)" }
node: { title: "whole" label: "whole\n/a/b/one.c:9:5\n8 bytes (dynamic,bounded)" }
node: { title: "sinf" label: "__builtin_sinf\n<built-in>" shape : ellipse }
node: { title: "__indirect_call" label: "Indirect Call Placeholder" shape : ellipse }
edge: { sourcename: "whole" targetname: "/a/b/one.c:part" label: "/a/b/one.c:11:3" }
edge: { sourcename: "whole" targetname: "__indirect_call" label: "/a/b/one.c:12:3" }
edge: { sourcename: "/a/b/one.c:part" targetname: "sinf" label: "/a/b/one.c:4:3" }
}
"""


def test_a_graph_is_read_as_gcc_writes_it() -> None:
    assert read_graphs([GRAPH]) == {
        "one.c:part": Function("one.c", 24, True, ("sinf",)),
        "whole": Function("one.c", 8, True, ("__indirect_call", "one.c:part")),
    }


def functions(frames: dict[str, int], calls: dict[str, str]) -> dict[str, Function]:
    return {name: Function("f.c", frame, True, tuple(calls.get(name, "").split())) for name, frame in frames.items()}


def test_the_deepest_chain_is_the_one_of_most_bytes() -> None:
    """Not the one of most calls; a function of the library counts as the rules say."""
    given = functions({"a": 10, "b": 20, "c": 30, "d": 200}, {"a": "b d", "b": "c", "c": "sinf", "d": ""})
    assert find_deepest(given, ["a"], Rules()) == Chain(210, ("a", "d"))
    assert find_deepest(given, ["a"], Rules(library={"sinf": 400})) == Chain(460, ("a", "b", "c", "sinf"))
    assert find_deepest(given, ["c", "b"], Rules(other=7)) == Chain(57, ("b", "c", "sinf"))


def test_recursion_is_followed_as_deep_as_the_rules_allow() -> None:
    given = functions({"run": 100, "restore": 50, "leaf": 5}, {"run": "restore leaf", "restore": "run"})
    assert find_deepest(given, ["run"], Rules()).bytes == 150
    assert find_deepest(given, ["run"], Rules(depth=2)) == Chain(300, ("run", "restore", "run", "restore"))
    assert find_deepest(given, ["run"], Rules(depth=3)).bytes == 450


def test_pointers_lead_to_the_functions_that_are_named() -> None:
    given = read_graphs([GRAPH]) | functions({"far": 1000, "near": 1}, {})
    assert find_deepest(given, ["whole"], Rules({"one.c": ("near", "far")})) == Chain(1008, ("whole", "far"))
    with pytest.raises(StackError, match=r"whole in one\.c calls through a pointer; name the functions"):
        find_deepest(given, ["whole"], Rules())
    with pytest.raises(StackError, match="the call graphs have no lost, main"):
        find_deepest(given, ["main"], Rules({"one.c": ("lost",)}))


def test_a_frame_that_grows_is_refused() -> None:
    given = {"a": Function("f.c", 16, False, ())}
    with pytest.raises(StackError, match=r"the frame of a in f\.c grows at run time"):
        find_deepest(given, ["a"], Rules())


PROGRAM = r"""
#include <math.h>
#include <stddef.h>
static __attribute__((noinline)) double sum(const double *x, int n)
{
    double part[100], whole = 0;
    int i;
    for (i = 0; i < n; ++i)
        part[i % 100] = x[i] * whole;
    for (i = 0; i < 100; ++i)
        whole += sin(part[i]);
    return whole;
}
double call(double (*f)(const double *, int), const double *x, int n) { return 1 + (f ? f(x, n) : 2 * sum(x, n)); }
double grow(int n) { double x[n]; x[0] = n; return 1 + call(NULL, x, n); }
"""


def test_a_compiled_program(requires: Requires, tmp_path: Path) -> None:
    """A frame holds its 100 numbers and not many more bytes."""
    source = tmp_path / "program.c"
    source.write_text(PROGRAM, "utf-8")
    found = compile_graphs([requires("gcc"), "-std=c99", "-O1"], [source], tmp_path)
    chain = find_deepest(found, ["call"], Rules({"program.c": ()}, other=8))
    assert chain.functions == ("call", "program.c:sum", "sin")
    assert 800 <= chain.bytes < 1000
    with pytest.raises(StackError, match="grows at run time"):
        find_deepest(found, ["grow"], Rules({"program.c": ()}))
