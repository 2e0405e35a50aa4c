"""Declarations of a controller's header, as Python reads them: of small headers, and of the solver's."""

from __future__ import annotations

from pathlib import Path

import cffi
import pytest

from mbsgen.resources import folder
from mbsrun.controllers.loading import ControllerError, Result, _declare, read_statuses

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
