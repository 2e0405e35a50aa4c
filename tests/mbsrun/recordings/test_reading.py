"""Recordings: what files mean, and every fault of a bad one at its place."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from mbsgen.errors import InputError
from mbsrun.recordings import READERS, lines, read_column, read_recording, spell

CSV = "# a note\nt,q[knee],hip [deg],x[toe] [mm],EMG [mV]\n0,0.1,90,1000,5\n0.1,,45,NaN,6\n0.2,0.3,-1e1,.5,7\n"
TRC = (
    "PathFileType\t4\t(X/Y/Z)\twalk.trc\n"
    "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n"
    "100\t100\t2\t2\tmm\t100\t1\t2\n"
    "Frame#\tTime\thip\t\t\tR.Knee\t\t\n"
    "\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n"
    "\n"
    "1\t0.00\t1\t2\t3\t\t\t\n"
    "2\t0.01\t4\t5\t6\t7\t8\t9\t\n"
)
STO = "walk\nversion=1\nnRows=2\nnColumns=3\ninDegrees=yes\nendheader\ntime\tknee\tpelvis_tx\n0\t180\t1\n0.5\tnan\t2\n"
SIMM = "name gait\ndatacolumns 3\ndatarows 2\nrange 0 1\nendheader\n  time   knee  grf_vy\n 0  1.5 700\n 1 2.5  nan \n"


def read(tmp_path: Path, name: str, text: str | bytes) -> object:
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_recording(path)


def test_a_table(tmp_path: Path) -> None:
    """Units are converted to SI; empty cells and NaN are gaps; another unit is kept."""
    path = tmp_path / "walk.csv"
    for text in (CSV, CSV.replace(",", ";"), CSV.replace(",", "\t"), CSV.replace("\n", "\r\n"), "\ufeff" + CSV):
        path.write_text(text, "utf-8")
        found = read_recording(path)
        assert found.names == ("q[knee]", "hip", "x[toe]", "EMG")
        assert [column.unit for column in found.columns] == ["", "rad", "m", "mV"]
        assert found.times.tolist() == [0, 0.1, 0.2]
        expected = [[0.1, math.pi / 2, 1, 5], [math.nan, math.pi / 4, math.nan, 6], [0.3, -math.pi / 18, 5e-4, 7]]
        np.testing.assert_allclose(found.values, expected, rtol=1e-15)
    path.write_text("Time [ms],a\n0,1\n500,2\n", "utf-8")
    assert read_recording(path).times.tolist() == [0, 0.5]


def test_markers(tmp_path: Path) -> None:
    """Positions in m; a marker's empty cells are a gap."""
    path = tmp_path / "walk.trc"
    path.write_text(TRC, "utf-8")
    found = read_recording(path)
    assert found.markers == ("hip", "R.Knee")
    assert found.times.tolist() == [0, 0.01]
    np.testing.assert_allclose(found.values[1], np.array([4, 5, 6, 7, 8, 9]) / 1000)
    assert np.isnan(found.values[0]).tolist() == [False] * 3 + [True] * 3


def test_times_of_markers_increase_whatever_their_frames_are(tmp_path: Path) -> None:
    found = read(tmp_path, "a.trc", TRC.replace("\n1\t0.00", "\n9\t0.00"))
    assert found.times.tolist() == [0, 0.01]  # type: ignore[attr-defined]
    with pytest.raises(InputError, match='column "Time": the time 0 follows 0'):
        read(tmp_path, "a.trc", TRC.replace("2\t0.01", "2\t0.00"))


def test_storage(tmp_path: Path) -> None:
    """Degrees are of angles alone: the unit of the use decides."""
    for name in ("walk.sto", "walk.MOT"):
        path = tmp_path / name
        path.write_text(STO, "utf-8")
        found = read_recording(path)
        np.testing.assert_allclose(read_column(found, "knee", "rad"), [math.pi, math.nan])
        np.testing.assert_allclose(read_column(found, "pelvis_tx", "m"), [1, 2])
    path.write_text(SIMM, "utf-8")
    found = read_recording(path)
    np.testing.assert_allclose(read_column(found, "grf_vy", "N"), [700, math.nan])
    with pytest.raises(InputError, match="inDegrees=yes"):  # the file does not say
        read_column(found, "knee", "rad")


HEAD = TRC[: TRC.index("1\t0.00")]
BAD = {
    "no suffix": ("walk.txt", CSV, ["walk.txt: found", ".csv, .trc, .mot, .sto"]),
    "empty": ("a.csv", " \n\n", ["a.csv: the file is empty"]),
    "no text": ("a.csv", b"t,a\n0,1\n1,\xff\n", ["a.csv:3: found bytes that are no UTF-8", "save it as UTF-8"]),
    "zero byte": ("a.csv", "t,a\n0,1\n1,\0\n", ["a.csv:3: found a zero byte"]),
    "no time": ("a.csv", "x,y\n0,1\n1,2\n", ["a.csv:1: no column is named t or time", '"x", "y"']),
    "time in m": ("a.csv", "t [m],y\n0,1\n1,2\n", ['a.csv:1: column 1: the time is in "m"', "s or ms"]),
    "no numbers": ("a.csv", "t,y\n", ["a.csv: found 0 rows of numbers"]),
    "one row": ("a.csv", "t,y\n0,1\n", ["a.csv:2: found one row"]),
    "twice": ("a.csv", "t,y,y\n0,1,2\n1,2,2\n", ['a.csv:1: column 3: "y" names column 2 too']),
    "unnamed": ("a.csv", "t,y,\n0,1,2\n1,2,2\n", ["a.csv:1: column 3: it has no name"]),
    "long name": ("a.csv", f"t,{'y' * 201}\n0,1\n1,2\n", ["a.csv:1: column 2: its name has 201 characters"]),
    "short row": ("a.csv", "t,y,z\n0,1\n1,2,3\n", ["a.csv:2: found 2 cells, and there are 3 columns"]),
    "a word": ("a.csv", "t,y\n0,one\n1,2\n", ['a.csv:2: column "y": found "one"', "a number with a point"]),
    "a comma": ("a.csv", "t;y\n0;1,5\n1;2\n", ['a.csv:2: column "y": found "1,5"']),
    "a number whose square overflows": (
        "a.csv",
        "t,y\n0,1e308\n1,2\n",
        ['a.csv:2: column "y": found "1e308"', "1e+30"],
    ),
    "times without a distance": ("a.csv", "t,y\n0,1\n1e-300,2\n", ['a.csv:3: column "t": the time 1e-300 follows 0']),
    "not Python's numbers": (
        "a.csv",
        "t,y\n0,1_0\n1,inf\n2,٣\n3,1e999\n",
        ["a.csv:2", "a.csv:3", "a.csv:4", "a.csv:5"],
    ),
    "gap in time": ("a.csv", "t,y\n0,1\n,2\n2,3\n", ['a.csv:3: column "t": this row has no time']),
    "time goes back": ("a.csv", "t,y\n0,1\n1,2\n1,3\n0.5,1\n", ["a.csv:4:", "the time 1 follows 1", "a.csv:5:"]),
    "quotes": ("a.csv", 't,y\n0,"1"2\n1,3\n', ["a.csv:2: the line cannot be split", "quotes"]),
    "all at once": ("a.csv", "t,y,y\n0,one,3\n1,2\n2,two,3\n", ["a.csv:1", "a.csv:2", "a.csv:3", "a.csv:4"]),
    "no TRC": ("a.trc", CSV, ["a.trc:1: found", "PathFileType"]),
    "short header": ("a.trc", "PathFileType\t4\n", ["a.trc:2: the header ends here"]),
    "header of four lines": ("a.trc", "\n".join(TRC.split("\n")[:4]), ["a.trc:4: the header ends here"]),
    "no rows": ("a.trc", "\n".join(TRC.split("\n")[:5]), ["NumFrames", "0 rows of numbers follow"]),
    "no unit": ("a.trc", TRC.replace("Units", "Unit"), ["a.trc:2: Units: it is missing"]),
    "inches": ("a.trc", TRC.replace("\tmm\t", "\tin\t"), ['a.trc:3: Units: found "in"', "m, cm or mm"]),
    "keys and values": ("a.trc", TRC.replace("\t100\t1\t2\n", "\t100\t1\n"), ["a.trc:3: found 7 values for 8 keys"]),
    "frames": ("a.trc", TRC.replace("100\t100\t2\t2", "100\t100\t3\t2"), ['a.trc:3: NumFrames: it is "3", and 2 rows']),
    "count": ("a.trc", TRC.replace("100\t2\t2", "100\t2\t3"), ['NumMarkers: it is "3", and 2 markers are named']),
    "labels": ("a.trc", TRC.replace("Frame#", "Row"), ["a.trc:4: found", "Frame#, a tab, and Time"]),
    "places": ("a.trc", TRC.replace("hip\t\t\t", "hip\t\t"), ["a.trc:4: names of markers are not three cells apart"]),
    "cut row": ("a.trc", TRC.replace("\t8\t9\t", ""), ["a.trc:8: found 6 cells, and there are 8 columns"]),
    "no frames": ("a.trc", HEAD.replace("100\t100\t2", "100\t100\t0"), ["a.trc: found 0 rows"]),
    "no end": ("a.sto", STO.replace("endheader", "end"), ["a.sto:1: no line says endheader"]),
    "nothing": ("a.sto", "a\nendheader\n\n", ["a.sto:2: nothing follows the header"]),
    "rows": ("a.sto", STO.replace("nRows=2", "nRows=3"), ['a.sto:3: nRows: it is "3", and 2 rows of numbers follow']),
    "columns": ("a.mot", STO.replace("nColumns=3", "nColumns=2"), ['a.mot:4: nColumns: it is "2", and 3 columns']),
    "degrees": ("a.sto", STO.replace("=yes", "=maybe"), ['a.sto:5: inDegrees: found "maybe"', "yes or no"]),
    "vectors": ("a.sto", "DataType=Vec3\n" + STO, ['a.sto:1: DataType: found "Vec3"', "DataType=double"]),
    "first column": ("a.sto", STO.replace("time", "frame"), ['a.sto:7: column 1: found "frame"', "be time"]),
    "infinite": ("a.sto", STO.replace("nan", "Inf"), ['a.sto:9: column "knee": found "Inf"']),
}


@pytest.mark.parametrize(("name", "text", "words"), BAD.values(), ids=BAD.keys())
def test_a_bad_file(tmp_path: Path, name: str, text: str, words: list[str]) -> None:
    """Each fault has its line, its column, a finding and a remedy."""
    with pytest.raises(InputError) as caught:
        read(tmp_path, name, text)
    for word in words:
        assert word in str(caught.value)
    assert all("; " in str(fault) for fault in caught.value.faults)


def test_what_is_too_much(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, limit, word in (
        ("MAX_BYTES", 20, "larger than 20 bytes"),
        ("MAX_ROWS", 2, "a.csv:4: there are more than 2 rows"),
        ("MAX_COLUMNS", 3, "a.csv:1: found 4 columns; give at most 3"),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(lines, name, limit)
            with pytest.raises(InputError, match=word):
                read(tmp_path, "a.csv", "t,a,b,c\n0,1,2,3\n1,2,3,4\n2,3,4,5\n")
    words = "".join(f"{k},word\n" for k in range(1000))
    with pytest.raises(InputError) as caught:
        read(tmp_path, "a.csv", "t,a\n" + words)
    assert len(caught.value.faults) < 30


@pytest.mark.parametrize("suffix", READERS)
@pytest.mark.parametrize("text", ["", "\n", "\t\t\n" * 9, '"', "PathFileType" + "\n\t" * 7, "endheader\n", "t\n1\n2"])
def test_no_rubbish_is_a_traceback(tmp_path: Path, suffix: str, text: str) -> None:
    try:
        found = read(tmp_path, f"a{suffix}", text)
    except InputError:
        return
    assert found.times.size == 2  # type: ignore[attr-defined]  # times alone are a recording


def test_columns_that_do_not_fit(tmp_path: Path) -> None:
    path = tmp_path / "walk.csv"
    path.write_text(CSV, "utf-8")
    found = read_recording(path)
    for name, unit, word in (
        ("hip", "m", 'it is in "rad"'),
        ("EMG", "N", '"mV"'),
        ("knee", "rad", 'mean "q\\[knee\\]"'),
    ):
        with pytest.raises(InputError, match=word):
            read_column(found, name, unit)


def test_names_of_columns_as_identifiers() -> None:
    assert [spell(x) for x in ("q[knee]", "x[R.Heel]", "/jointset/hip/value")] == [
        "q_knee",
        "x_R_Heel",
        "jointset_hip_value",
    ]
