"""A controller in Python by hand: declarations of headers, rows of data, limits, predictions, statuses."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cffi
import numpy as np
import pytest

from mbsgen.resources import folder
from mbsrun.controllers.loading import Controller, ControllerError, Result, _declare, read_statuses

HEADER = """
/* A comment
 * of two lines: int hidden_by_comment; */
#ifndef GUARD_H
#define GUARD_H
#include <stddef.h>
#ifdef __cplusplus
extern "C" {
int hidden_by_cpp;
#if SOMETHING
int hidden_within;
#endif
int hidden_after;
#else
extern int plain_c; /* kept */
#endif
#define COUNT 12
#define TEXT "no number"
#define VALUE 1.5
    #define INDENTED 7
#if !defined(FLOAT)
typedef double real;
#else
typedef float real;
#endif
extern int last[COUNT];
#endif
"""


def test_a_header_keeps_what_a_plain_compiler_reads(tmp_path: Path) -> None:
    """Conditions of `#ifdef` are false, others true; numbers are defined, other macros are not."""
    (tmp_path / "a.h").write_text(HEADER, "utf-8")
    found = [line.strip() for line in _declare(tmp_path / "a.h").splitlines() if line.strip()]
    assert found == [
        "extern int plain_c;",
        "#define COUNT 12",
        "#define INDENTED 7",
        "typedef double real;",
        "extern int last[COUNT];",
    ]
    ffi = cffi.FFI()
    ffi.cdef(_declare(tmp_path / "a.h"))
    assert ffi.sizeof(ffi.typeof("real")) == 8


def test_statuses_are_the_words_of_an_enumeration_in_its_order(tmp_path: Path) -> None:
    names = ["SOLVED", "ACCEPTABLE", "TIME_LIMIT"]
    body = ", ".join(f"MBS_STAGES_{name}" for name in names)
    (tmp_path / "mbs_stages.h").write_text(f"typedef enum {{{body}}} mbs_stages_status;\n", "utf-8")
    assert read_statuses(tmp_path) == ("solved", "acceptable", "time limit")
    own = read_statuses(folder("csrc") / "stages")
    assert own[:4] == ("solved", "acceptable", "infeasible", "iteration limit")
    assert "stepped" in own


def test_a_folder_without_a_header_is_named(tmp_path: Path) -> None:
    with pytest.raises(ControllerError, match=r"mbs_stages\.h: .*; write the folder again"):
        read_statuses(tmp_path)


@pytest.mark.parametrize(
    ("status", "is_solved"), [("solved", True), ("acceptable", True), ("time limit", False), ("infeasible", False)]
)
def test_acceptable_is_solved_too(status: str, *, is_solved: bool) -> None:
    assert Result(status, "", None, 3, 1.0, 0.0, 0.0).is_solved == is_solved


# --- arguments ------------------------------------------------------------------------------------------------------

STRUCTS = """
typedef struct { int iterations; double seconds; double tolerance; double (*clock)(void *); int warm; } c_limits;
"""


def make(**given: Any) -> Any:
    """Make a controller of two states and one input without C; `called` answers its calls."""
    own: Any = Controller.__new__(Controller)
    fields = [SimpleNamespace(name=name, size=size, rows=0) for name, size in (("start", 3), ("end_q", 2))]
    own.manifest = SimpleNamespace(
        data=fields, states=("q", "qd"), inputs=("u",), intervals=4, predicts=True, symbols="s", **given
    )
    own.folder, own._name, own._ffi, own._statuses = Path("made"), "c", cffi.FFI(), ("solved", "prepared", "stepped")
    own._ffi.cdef(STRUCTS)
    own._clock = own._ffi.NULL
    own.data = {"start": np.array([1.0, 2.0, 3.0]), "end_q": np.array([[4.0], [5.0]])}
    own.calls = []
    return own


def test_rows_of_a_batch_are_the_controllers_data_where_none_are_given() -> None:
    """States stand first; each name has its own columns, in the manifest's order."""
    rows, count = make()._collect([[7.0, 8.0], [9.0, 10.0]], {})
    assert (rows.tolist(), count) == ([[7, 8, 3, 4, 5], [9, 10, 3, 4, 5]], 2)
    rows, count = make()._collect(None, {"end_q": [[[6.0], [7.0]]]})
    assert (rows.tolist(), count) == ([[1, 2, 3, 6, 7]], 1)
    rows, count = make()._collect([[7.0, 8.0]], {"start": [[0.0, 0.0, 9.0]]})
    assert (rows.tolist(), count, rows.flags.c_contiguous) == ([[7, 8, 9, 4, 5]], 1, True)
    assert make()._collect(np.zeros((0, 2)), {})[1] == 0


@pytest.mark.parametrize(
    ("states", "data", "told"),
    [
        (None, {}, "give states, or rows of data"),
        (None, {"goal": [[1.0]]}, "there is no 'goal'; there are start, end_q"),
        ([[1.0, 2.0]], {"end_q": [[1.0, 2.0], [3.0, 4.0]]}, "the rows differ in number: end_q 2, states 1"),
        ([1.0, 2.0], {}, r"states has shape \(2,\); give rows of 2 numbers"),
        ([[1.0, 2.0, 3.0]], {}, r"states has shape \(1, 3\); give rows of 2"),
        ([["a", "b"]], {}, "states: no array of numbers; give rows of 2"),
        (None, {"start": [[1.0], [2.0]]}, r"start has shape \(2, 1\); give rows of 3"),
    ],
)
def test_rows_of_a_batch_that_do_not_fit_are_refused(states: Any, data: dict[str, Any], told: str) -> None:
    with pytest.raises(ControllerError, match=told):
        make()._collect(states, data)


def test_a_batch_needs_a_thread() -> None:
    with pytest.raises(ControllerError, match="threads = 0: give at least one"):
        make().solve_batch([[1.0, 2.0]], threads=0)


def test_vectors_have_their_size() -> None:
    assert make()._check("state", [1, 2], 2).tolist() == [1.0, 2.0]
    for values, told in (([1.0], r"shape \(1,\); give 2 numbers"), ([[1.0, 2.0]], r"\(1, 2\)"), (["a"], "no vector")):
        with pytest.raises(ControllerError, match=f"state .*{told}"):
            make()._check("state", values, 2)


def test_limits_are_above_0_and_0_stands_for_none() -> None:
    """A clock is needed for seconds alone."""
    own = make()
    own._clock = own._ffi.callback("double(void *)", lambda _: 0.0)
    found = own._limit(iterations=7, seconds=None, tolerance=1e-3)
    assert (found.iterations, found.seconds, found.tolerance, found.clock) == (7, 0.0, 1e-3, own._ffi.NULL)
    found = own._limit(iterations=None, seconds=0.5)
    assert (found.iterations, found.seconds, found.clock) == (0, 0.5, own._clock)
    for name in ("iterations", "seconds", "tolerance"):
        for limit in (0, -1):
            with pytest.raises(ControllerError, match=f"{name} = {limit} is no limit"):
                own._limit(**{name: limit})
    with pytest.raises(ControllerError, match="seconds = nan"):
        own._limit(seconds=float("nan"))


def answer(own: Any, status: Any, write: float | None = None) -> Any:
    """Answer calls of the C of a controller by a status, and write a number into the last array."""

    def call(function: str, *arguments: Any) -> Any:
        own.calls.append((function, len(arguments)))
        if write is not None:
            arguments[-1][0] = write
        return status

    own._call = call
    own._controller = None
    return own


def test_predictions_need_a_model_a_time_and_a_step() -> None:
    own = answer(make(), 0, 5.0)
    assert own.predict([1.0, 2.0], [3.0], 0.0, 1).tolist() == [5.0, 0.0]
    assert own.calls == [("predict", 6)]
    for seconds, steps in ((-1e-9, 1), (float("nan"), 1), (1.0, 0)):
        with pytest.raises(ControllerError, match="give a time and at least one step"):
            own.predict([1.0, 2.0], [3.0], seconds, steps)
    with pytest.raises(ControllerError, match="state has shape"):
        own.predict([1.0], [3.0], 1.0)
    with pytest.raises(ControllerError, match="inputs has shape"):
        own.predict([1.0, 2.0], [3.0, 4.0], 1.0)
    with pytest.raises(ControllerError, match="no acceleration on the way"):
        answer(make(), 3).predict([1.0, 2.0], [3.0], 1.0)
    own.manifest.predicts = False
    with pytest.raises(ControllerError, match="made: the model's motion is not part of it"):
        own.predict([1.0, 2.0], [3.0], 1.0)


def test_a_gain_is_there_after_a_preparation_alone() -> None:
    assert answer(make(), 1, 5.0).gain().tolist() == [[5.0, 0.0]]
    for status in (0, 2):
        with pytest.raises(ControllerError, match="made: there is no feedback matrix; call prepare first"):
            answer(make(), status).gain()


def test_a_controller_that_no_memory_holds_is_refused() -> None:
    own = make()
    own._call = lambda name, *_: 64 if name == "bytes" else own._ffi.NULL
    with pytest.raises(ControllerError, match="no controller can be made of it; write the folder again"):
        own._make()
    made: list[int] = []
    own._call = lambda name, *given: 64 if name == "bytes" else made.append(given[1]) or given[0]
    memory, begin = own._make()
    first, address = (int(own._ffi.cast("uintptr_t", x)) for x in (memory, begin))
    assert made == [64]
    assert address % 16 == 0
    assert 0 <= address - first < 16
    assert own._ffi.sizeof(memory) >= address - first + 64


def test_outcomes_have_the_words_of_their_statuses() -> None:
    """A stage is named where a function failed there, the first one too."""
    own = make()
    for stage, named in ((-1, None), (0, 0), (3, 3)):
        found = SimpleNamespace(
            status=2, stage=stage, violation=1.0, stationarity=2.0, deviation=3.0, length=4.0, iterations=5, cost=6.0
        )
        own._call = lambda name, *_, found=found: own._ffi.new("char[]", b"told") if name == "explain" else found
        own._controller = None
        step, result = own._describe_step(), own._describe_result()
        assert (step.status, step.message, step.stage) == (result.status, result.message, result.stage)
        assert (step.status, step.message, step.stage) == ("stepped", "told", named)
        assert (step.violation, step.stationarity, step.deviation, step.length) == (1.0, 2.0, 3.0, 4.0)
        assert (result.iterations, result.cost, result.violation, result.stationarity) == (5, 6.0, 1.0, 2.0)


def test_equations_are_found_stage_by_stage() -> None:
    """Of variables that are put into the iterate; a stage without a value is named."""
    own = make()
    w = own._ffi.new("double[3]")
    point = SimpleNamespace(w=w, variables=3, rows=2)

    def call(name: str, *given: Any) -> Any:
        if name == "get_iterate":
            return point
        _, k, _, e, *_ = given
        for i in range(k + 1):
            e[i] = 10 * k + i + w[i]
        return int(k == 2)

    own._call, own._controller = call, None
    found = own.find_equations(np.array([0.25, 0.5, 0.75]), (1, 2))
    assert found.tolist() == [0.25, 10.25, 11.5]
    assert list(w) == [0.25, 0.5, 0.75]
    with pytest.raises(ControllerError, match="the functions of stage 2 have no value"):
        own.find_equations(np.zeros(3), (1, 2, 3))
