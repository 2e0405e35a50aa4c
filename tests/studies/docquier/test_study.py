"""The whole study, on a small problem: killed, resumed, exported, reported; and its page in a browser."""

from __future__ import annotations

import csv
import html
import json
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from pyarrow import parquet

from mbsgen.errors import InputError, MbsError
from mbsrun.environment import describe_environment
from mbsrun.measuring.page import render_page
from mbsrun.measuring.sections import (
    Caption,
    Outline,
    Picture,
    Section,
    Table,
    distinguish,
    read_folders,
    write_csv,
    write_outline,
    write_section,
    write_table,
)
from mbsrun.ocp.problem.problem import Representation
from mbsrun.ocp.searching.attempts import find_lowest
from mbsrun.ocp.searching.cluster import ClusterError, open_workers
from mbsrun.ocp.searching.executor import LocalExecutor
from mbsrun.ocp.searching.search import LOST, LostMotionError, Progress, Search
from mbsrun.ocp.searching.study import Study, Targets, identify
from mbsrun.ocp.searching.trials import Found, Trial
from mbsrun.ocp.solution.record import Attempt, Task, open_record
from mbsrun.ocp.solving.solve import Solver
from studies.docquier.campaign import (
    QUESTIONS,
    STORE,
    Campaign,
    Step,
    Subject,
    carry_out,
    choose_steps,
    describe_extent,
    gather,
    hold,
    list_attempts,
    list_lowest,
    list_tasks,
    read_subject,
    report,
    restore,
)
from studies.docquier.differentiated import Differentiated
from studies.docquier.export import export
from studies.docquier.figures import drawn_as, name_set, save
from studies.docquier.markdown import ARCHIVE, write_archive, write_page
from studies.docquier.nonzeros import count_groups, explain_nonzeros
from studies.docquier.optima import OPTIMA, tabulate_optima
from studies.docquier.robustness import State, describe_outcome, find_state, list_slices, report_robust

MODELS = Path(__file__).parents[3] / "models"
COUNTS = {"bumps": (6, 2), "noise": (0, 0), "waves": (0, 0), "branches": (0, 0), "turns": (0, 0)}
FEW = (
    f"import mbsrun.ocp.searching.trials as s; s.COUNTS, s.HOPS = {COUNTS}, (0, 0); from mbsrun.cli import main; main()"
)
AZIMUTHS = (0.7, 1.3, 7)
SMOOTH, ROUGH = (1.0, 10.0), (1.0, 0.0)


@pytest.fixture(scope="module")
def problem(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the reach around a post on a coarse grid: a solve takes some hundredths of a second."""
    folder = tmp_path_factory.mktemp("problem")
    text = (MODELS / "planar_arm_reach.ocp.yaml").read_text("utf-8")
    text = text.replace("intervals: 50", "intervals: 6").replace("degree: 4", "degree: 2")
    (folder / "planar_arm.yaml").write_bytes((MODELS / "planar_arm.yaml").read_bytes())
    (folder / "reach.ocp.yaml").write_text(text, "utf-8")
    return folder / "reach.ocp.yaml"


@pytest.fixture(scope="module")
def subject(problem: Path) -> Subject:
    return read_subject(problem)


@pytest.fixture
def campaign(subject: Subject, monkeypatch: pytest.MonkeyPatch) -> Campaign:
    """State the robust protocol for seven targets, with few starts."""
    monkeypatch.setattr("mbsrun.ocp.searching.trials.COUNTS", COUNTS)
    monkeypatch.setattr("mbsrun.ocp.searching.trials.HOPS", (0, 0))
    targets = Targets(0.55, tuple(np.linspace(*AZIMUTHS).tolist()), (0.0,))
    study = Study(subject.problem, "hand", targets, (SMOOTH, ROUGH), (Representation.IMPL,), (0, 1), method="mbs")
    return Campaign(subject, study, ("robust",), (), (), is_quick=True)


def solve_alone(campaign: Campaign, out: Path) -> list[Attempt]:
    """Carry a campaign out in this process; list what was tried this time."""
    seen: list[Attempt] = []

    def watch(step: Step) -> None:
        if step.last is not None:
            seen.append(step.last)

    out.mkdir(exist_ok=True)
    with open_workers(0, None) as executor_for:
        assert carry_out(campaign, out, executor_for, watch, 1e9)
    return seen


def test_what_is_killed_loses_nothing_and_does_nothing_twice(campaign: Campaign, problem: Path, tmp_path: Path) -> None:
    """SIGKILL to the command amid the robust protocol on a Dask cluster; then on, to the end of a run in one go."""
    out = tmp_path / "killed"
    command = [sys.executable, "-c", FEW, "study", str(problem), "-o", str(out), "--workers", "1"]
    grid = ["--radius", "0.55", "--azimuths", *map(str, AZIMUTHS), "--heights", "0", "0", "1"]
    chosen = ["--protocol", "robust", "--cost", "1", "10", "--cost", "1", "0", "--representation", "IMPL"]
    process = subprocess.Popen([*command, *grid, *chosen], stderr=subprocess.PIPE)
    try:
        while count(out) < 5:
            assert process.poll() is None, (process.stderr or sys.stdin).read()
            time.sleep(0.01)
    finally:
        process.send_signal(signal.SIGKILL)
        process.communicate()
    before = count(out)
    after = solve_alone(campaign, out)
    whole = solve_alone(campaign, tmp_path / "whole")
    assert 5 <= before < len(whole)
    assert before + len(after) == len(whole)
    first, second = (sort_attempts(list_attempts(campaign, tmp_path / n)) for n in ("killed", "whole"))
    assert list(map(timeless, first)) == list(map(timeless, second))
    costs = [[row["cost"] for row in rows] for rows in (first, second)]
    np.testing.assert_allclose(*costs, rtol=1e-12)  # BLAS rounds otherwise in another process, in rare cases
    assert solve_alone(campaign, out) == []
    tell_what_is_left(campaign, out, whole)


def tell_what_is_left(campaign: Campaign, out: Path, tried: list[Attempt]) -> None:
    """The report says for each cost that the search is through, what it took, and that none is left."""
    with open_record(out / STORE, identify(campaign.study, campaign.subject.plant.manifest)) as record:
        results = gather(campaign, record, (), [])
        states = {w: find_state(replace(campaign.study, costs=(w,)), record) for w in campaign.study.costs}
    section = report_robust(results, states)
    assert section is not None
    assert section.text.count("all 7 tasks are solved, and none is left in a higher minimum") == 2
    left, parts, _ = (item for item in section.items if isinstance(item, Table))
    assert [(row[2:6], row[-2:]) for row in left.rows] == [((7, 7, 7, 0), ("through", 7))] * 2
    assert sum(int(row[2]) for row in parts.rows if isinstance(row[2], int)) == len(tried)
    ended = State(Progress(1, 9, 4, is_through=False), replace(campaign.study.targets, every=(3, 1)))
    told = describe_outcome(results, SMOOTH, [a for a in tried if a.task.weights == SMOOTH], ended)
    assert "in round 1, with 4 of 9 attempts; for a slice of 3 of 7 targets it is through: all 3 tasks" in told
    for weights in campaign.study.costs:
        firsts = [row[4] for row in parts.rows if row[0] == name_set(weights)]
        assert sum(number for number in firsts if isinstance(number, int)) == 7


def count(out: Path) -> int:
    """Count the attempts in a store, from aside."""
    if not (out / "study.sqlite").exists():
        return 0
    with closing(sqlite3.connect(f"file:{out / 'study.sqlite'}?mode=ro", uri=True)) as connection:
        try:
            return int(connection.execute("select count(*) from attempts").fetchone()[0])
        except sqlite3.OperationalError:  # it is being made
            return 0


def sort_attempts(rows: Iterable[dict[str, object]]) -> list[dict[str, object]]:
    return sorted(rows, key=timeless)


def timeless(row: dict[str, object]) -> str:
    """Describe an attempt without times, and without the cost, a number that BLAS rounds."""
    return str({name: value for name, value in row.items() if "seconds" not in name and name != "cost"})


def test_a_study_is_asked_reported_and_exported(
    campaign: Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The paper's protocol and two questions; every attempt is a row of both forms, with versions."""
    two = (Representation.IMPL, Representation.EXP2_O)
    study = replace(campaign.study, targets=replace(campaign.study.targets, every=(3, 1)), representations=two)
    asked = replace(campaign, study=study, protocols=("paper",), questions=("repeats", "grids", "shooting", "guess"))
    tried = solve_alone(asked, tmp_path)
    monkeypatch.setattr(
        "studies.docquier.campaign.count_growth", lambda: ()
    )  # takes seconds; the generator's tests hold it
    rows = list_attempts(asked, tmp_path)
    assert len(rows) == len(tried)
    assert {row["part"] for row in rows} >= {"paper", "repeats", "grids", "shooting", "guess"}
    table = parquet.read_table(export(rows, tmp_path / "attempts", "parquet"))
    assert table.num_rows == len(rows)
    assert table["cost"].to_pylist() == [row["cost"] for row in rows]
    with export(rows, tmp_path / "attempts", "csv").open(encoding="utf-8") as file:
        again = list(csv.DictReader(file))
    assert [float(row["cpu_seconds"]) for row in again] == [row["cpu_seconds"] for row in rows]
    assert all(row["casadi"] and row["processor"] and row["tolerance"] for row in again)
    sections = {section.name: section for section in report(asked, tmp_path)}
    assert set(sections) == {
        "summary",
        "run",
        "statements",
        "tables",
        "figures",
        "guess",
        "grids",
        "shooting",
    }
    success = next(item for item in sections["tables"].items if item.title == "Success rates")
    assert isinstance(success, Table)
    assert [row[2:4] for row in success.rows] == [(3, 3)] * 4
    assert "Fig. 9: cost at the optimum" in [item.title for item in sections["figures"].items]
    check_lowest(asked, tmp_path)
    text = write_page("Title", describe_extent(asked, tmp_path), list(sections.values()), tmp_path / "page").read_text()
    assert "With k1 = 1, k2 = 10 the record is complete: 6 of 6 solves, 3 of 3 targets in all 2 representations" in text
    assert "Solved by IPOPT with " in text
    assert "| k1 = 1, k2 = 0 | EXP2-O | 3 | 3 | 100 |" in text
    assert "![Fig. 9: cost at the optimum](fig_9.svg)" in text
    names = [write_archive([*sections.values()], [], tmp_path / f"{k}.tar.xz", tmp_path / k) for k in ("a", "b")]
    assert names[0].read_bytes() == names[1].read_bytes()


def check_lowest(asked: Campaign, out: Path) -> None:
    """Every target and cost has one lowest optimum, which is certified; it is the least cost of the record."""
    optima = list_lowest(asked, out)
    assert len(optima) == 6
    assert all(optimum.is_certified and 1 <= optimum.found <= optimum.tried == 2 for optimum in optima)
    with open_record(out / STORE, identify(asked.study, asked.subject.plant.manifest)) as record:
        lowest = find_lowest(list(record.attempts()))
    assert {(o.task.place, o.task.weights): o.cost for o in optima} == lowest


def test_a_study_goes_on_from_the_page_of_another(
    campaign: Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All attempts and certificates count; no task is solved twice, except for a motion that is needed."""
    paper = replace(campaign, protocols=("paper",))
    made = solve_alone(paper, tmp_path / "first")
    page = write_files(paper, tmp_path / "first")
    again = tmp_path / "second"
    again.mkdir()
    assert f"{len(made)} attempts and 14 certificates are in the record" in restore(campaign, again, page)
    assert restore(campaign, again, page).endswith("are in the record")  # a second time changes nothing
    assert list_attempts(paper, again) == list_attempts(paper, tmp_path / "first")
    with monkeypatch.context() as patch:
        patch.setattr("studies.docquier.optima.certify_motion", lambda *_: pytest.fail("the page has a certificate"))
        assert write_files(paper, again).joinpath(OPTIMA).read_bytes() == page.joinpath(OPTIMA).read_bytes()
    assert solve_alone(paper, again) == []
    solve_alone(campaign, tmp_path / "first")
    robust = write_files(campaign, tmp_path / "first")
    third = tmp_path / "third"
    third.mkdir()
    restore(campaign, third, robust)
    study, plant = campaign.study, campaign.subject.plant
    with open_record(third / STORE, identify(study, plant.manifest)) as record:
        search = Search(study, LocalExecutor(plant, describe_environment()), record)
        best = record.best("robust")
        late = next(task for task, found in best.items() if found.round == max(b.round for b in best.values()))
        motion = search.find_motion(late, "robust")
        assert motion is not None
        kept = record.best_motion(late, "robust")
        assert kept is not None
        np.testing.assert_array_equal(kept.point_q, motion.point_q)
        record._connection.execute("update best set motion = ''")
        record._connection.execute("update attempts set cost = cost + 1 where protocol = 'paper'")
        record._connection.execute("update best set cost = cost + 1 where protocol = 'paper'")
        lost = Task((0, 0), SMOOTH, "IMPL")
        with pytest.raises(LostMotionError, match="begin a new record"):
            search.find_motion(lost, "paper")
        trial = Trial(lost, "paper", "neighbours", "0,0 IMPL 1", Found(lost), 1)
        search.try_all([trial])
        assert [(a.status, a.cost) for a in record.attempts() if a.key == trial.key] == [(LOST, None)]


def write_files(campaign: Campaign, out: Path) -> Path:
    """Write the archive and the optima of a page."""
    page = out / "page"
    page.mkdir(exist_ok=True)
    write_csv(tabulate_optima(campaign.study, list_lowest(campaign, out)), page / OPTIMA)
    attempts = export(list_attempts(campaign, out), out / "attempts", "csv")
    write_archive([], [attempts], page / ARCHIVE, out / "tables")
    return page


def test_faults_of_a_page_are_told_with_file_and_line(campaign: Campaign, tmp_path: Path) -> None:
    solve_alone(replace(campaign, protocols=("paper",)), tmp_path / "out")
    page = write_files(replace(campaign, protocols=("paper",)), tmp_path / "out")
    optima, text = page / OPTIMA, (page / OPTIMA).read_text()
    optima.write_text(text.replace(",yes,", ",perhaps,", 1))
    with pytest.raises(InputError, match=r"optima.csv:2: is_minimum: Input should be a valid boolean"):
        restore(campaign, tmp_path, page)
    optima.write_text(text.replace("cost", "price"))
    with pytest.raises(InputError, match="no column cost"):
        restore(campaign, tmp_path, page)
    optima.write_text(text)
    attempts = tmp_path / "out" / "attempts.csv"
    attempts.write_text(attempts.read_text().replace("Solve_Succeeded,", "fine,many,", 1))
    write_archive([], [attempts], page / ARCHIVE, tmp_path / "tables")
    with pytest.raises(InputError, match=r"tables.tar.xz:2: iterations"):
        restore(campaign, tmp_path, page)
    write_archive([], [], page / ARCHIVE, tmp_path / "none")
    with pytest.raises(InputError, match=r"holds no attempts\.csv"):
        restore(campaign, tmp_path, page)
    (page / ARCHIVE).write_bytes(b"no archive")
    with pytest.raises(InputError, match="cannot be read"):
        restore(campaign, tmp_path, page)


def test_nonzeros_are_counted_by_group(subject: Subject) -> None:
    """All groups together are the Hessian; two inputs on six intervals; a program of another size is not compared."""
    groups = count_groups(replace(subject.problem, representation=Representation.IMPL), subject.plant)
    functions = Solver(replace(subject.problem, representation=Representation.IMPL), subject.plant).program.casadi
    assert groups.total == functions.hessian.nnz_out(0)
    assert groups.inputs == 2 * 6 + 2 * 5
    assert groups.end == {(0, 0), (0, 1), (1, 1)}
    assert explain_nonzeros(subject.problem, subject.plant) is None


def test_questions_take_the_linear_solver_of_the_campaign_and_shoot_at_no_closed_loops(campaign: Campaign) -> None:
    bar = read_subject(MODELS / "five_bar_reach.ocp.yaml")
    asked = replace(campaign, systems=(bar,), study=replace(campaign.study, linear_solver="mbs"))
    for question in QUESTIONS:
        lists = list_tasks(asked, question)
        assert {tasks.study.linear_solver for tasks in lists} == {"mbs"}
        assert any(tasks.folder == bar.folder for tasks in lists) is (question == "systems")


def test_an_unreachable_cluster_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ClusterError, match="no cluster with a worker"), open_workers(0, "nothing://127.0.0.1:1"):
        pass
    with hold(tmp_path), pytest.raises(MbsError, match="another study is at work"), hold(tmp_path):
        pass


def test_slices_are_spread_over_all_targets() -> None:
    paper = Targets(0.63, tuple(range(21)), tuple(range(11)))
    assert choose_steps(paper, 33) == (2, 5)
    assert choose_steps(paper, 231) == (1, 1)
    assert choose_steps(paper, 1000) == (1, 1)
    assert choose_steps(Targets(1.0, (0.0,), (0.0,)), 5) == (1, 1)
    part = replace(paper, every=(2, 5)).spread
    assert sorted(part) == sorted(replace(paper, every=(2, 5)).places)
    assert {i for i, _ in part[:12]} == {0, 4, 8, 12, 16, 20}
    coarser = list_slices(replace(paper, every=(2, 5)))
    assert [x.every for x in coarser[:3]] == [(2, 5), (2, 10), (4, 5)]
    assert list_slices(Targets(1.0, (0.0,), (0.0,))) == [Targets(1.0, (0.0,), (0.0,))]


# --- the page ------------------------------------------------------------------------------------------------------

HOSTILE = "</script><script>document.title = 'hostile'</script><b onclick='x'>"
SVG = b'<svg xmlns="http://www.w3.org/2000/svg" width="900" height="10"><script>top.hostile = 1</script></svg>'


@pytest.mark.parametrize("form", ["svg", "png", "pdf"])
def test_pictures_have_the_format_that_is_asked_for(form: str, tmp_path: Path) -> None:
    """A file of the format, equal each time; a page has a picture that browsers show."""
    starts = {"svg": b"<?xml", "png": b"\x89PNG", "pdf": b"%PDF"}
    pictures = []
    for _ in range(2):
        figure = Figure()
        figure.subplots().plot([1, 2])
        with drawn_as(form):
            pictures.append(save(figure, "a line", "rises"))
    write_section(Section("lines", "Lines", "", tuple(pictures)), tmp_path)
    first, second = (tmp_path / f"lines_{k}.{form}" for k in (1, 2))
    assert first.read_bytes() == second.read_bytes()
    assert first.read_bytes().startswith(starts[form])
    assert pictures[0].kind == ("image/png" if form == "png" else "image/svg+xml")
    assert pictures[0].content.startswith(starts["png" if form == "png" else "svg"])
    write_page("Title", [], [Section("lines", "Lines", "", tuple(pictures))], tmp_path / "page")
    assert (tmp_path / "page" / f"lines_1.{'png' if form == 'png' else 'svg'}").is_file()


def test_folders_are_taken_in(tmp_path: Path) -> None:
    """Tables by their keys, lists of objects as tables, pictures; outlines order and explain them; all else is left."""
    table = Table(HOSTILE, ("a", "b"), ((1, "x"), (None, True)), "note")
    (tmp_path / "one").mkdir()
    (tmp_path / "two").mkdir()
    write_table(table, tmp_path / "one", "one")
    (tmp_path / "one" / "points.json").write_text(
        '[{"ns": {"shortest": 1.5}, "way": "impl"}, {"error": 1e-16}]', "utf-8"
    )
    (tmp_path / "one" / "other.json").write_text('{"rows": 3}', "utf-8")
    (tmp_path / "one" / "broken.json").write_text("{", "utf-8")
    (tmp_path / "one" / "map.svg").write_bytes(SVG)
    (tmp_path / "two" / "map.svg").write_bytes(SVG)
    captions = (Caption("map.svg", HOSTILE, "a map"), Caption("../one/map.svg", "outside"), Caption("points.json"))
    write_outline(Outline("../chart", 1, "Charts", "how", captions), tmp_path / "one")
    (tmp_path / "two" / "broken.section.json").write_text('{"name": 3}', "utf-8")
    chart, one, two = read_folders([tmp_path / "one", tmp_path / "two"])
    assert (chart.name, chart.title, one.name, two.title) == ("chart", "Charts", "one", "two")
    picture, points = chart.items
    assert isinstance(picture, Picture)
    assert isinstance(points, Table)
    assert (picture.title, picture.note, picture.content) == (HOSTILE, "a map", SVG)
    assert (points.title, points.columns) == ("points", ("ns shortest", "way", "error"))
    assert one.items == (table,)
    assert [item.title for item in two.items] == ["map"]
    assert [section.name for section in distinguish([one, chart, one])] == ["one", "chart", "one_2"]
    (tmp_path / "empty").mkdir()
    for folder, told in ((tmp_path / "empty", "neither a table"), (tmp_path / "nowhere", "not a folder")):
        with pytest.raises(InputError, match=told):
            read_folders([folder])


def test_the_page_sorts_fits_a_phone_and_runs_nothing_else(tmp_path: Path, requires: Callable[[str], str]) -> None:
    """In a browser: a frame as wide as a phone, a click on a column, what hostile names and pictures have done."""
    rows = tuple((n, f"{HOSTILE if n == 3 else 'text ' * 20}", n / 7) for n in (10, 9, 3, 20))
    table = Table(HOSTILE, tuple(f"column {k} with a name" for k in range(3)), rows, HOSTILE)
    items = (table, Picture(HOSTILE, "image/svg+xml", SVG, HOSTILE))
    page = render_page(HOSTILE, [HOSTILE], [Section("x", HOSTILE, HOSTILE, items)])
    assert page == render_page(HOSTILE, [HOSTILE], [Section("x", HOSTILE, HOSTILE, items)])
    assert "<script>document" not in page
    outside = f"""<!DOCTYPE html><iframe id="f" style="width: 390px" srcdoc="{html.escape(page)}"></iframe>
        <pre id="out"></pre><script>
        const frame = document.getElementById("f");
        frame.onload = () => {{
          const inner = frame.contentDocument;
          const [first] = inner.querySelectorAll("th button");
          const column = () => [...inner.querySelectorAll("tbody tr")].map((row) => row.cells[0].innerText);
          first.click();
          const up = column();
          first.click();
          const picture = inner.querySelector("figure img");
          const fitted = picture.getBoundingClientRect().width;
          picture.click();
          document.getElementById("out").innerText = JSON.stringify({{
            up, down: column(), width: inner.documentElement.scrollWidth,
            fitted, whole: picture.getBoundingClientRect().width,
            title: document.title, hostile: window.hostile === undefined,
          }});
        }};</script>"""
    (tmp_path / "outside.html").write_text(outside, "utf-8")
    settings = ["--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=5000", "--dump-dom"]
    browser = [requires("chromium"), *settings, f"--user-data-dir={tmp_path / 'profile'}"]
    run = subprocess.run(
        [*browser, (tmp_path / "outside.html").as_uri()], capture_output=True, text=True, timeout=60, check=False
    )
    assert '<pre id="out">{' in run.stdout, run.stderr
    told = json.loads(html.unescape(run.stdout.partition('<pre id="out">')[2].partition("</pre>")[0]))
    assert told["up"] == ["3", "9", "10", "20"]
    assert told["down"] == ["20", "10", "9", "3"]
    assert told["width"] <= 390
    assert told["fitted"] < told["whole"] == 900
    assert (told["title"], told["hostile"]) == ("", True)


# --- derivatives ---------------------------------------------------------------------------------------------------


def test_derivatives_of_casadi_are_those_that_are_generated(subject: Subject) -> None:
    """Of EXP2, a name that C has too: value, Jacobian, and the adjoint's Jacobian, at one state, to rounding."""
    state = {"q": [0.3, 0.9], "qd": [1.0, -2.0], "u": [3.0, 4.0]}
    functions = [subject.plant.casadi("exp2")]
    functions += [Differentiated(subject.plant, subject.model, way).casadi("exp2") for way in (True, False)]
    found = []
    for function in functions:
        adjoint = function.reverse(1)
        value = function(**state)["qdd"]
        out = {"out_qdd": value}
        first = function.jacobian()(**state, **out)
        seeded = {**state, **out, "adj_qdd": [0.7, -0.2]}
        rest = {name: 0 for name in adjoint.jacobian().name_in() if name not in seeded}
        second = adjoint.jacobian()(**seeded, **rest)
        found.append([value.full(), *(first[f"jac_qdd_{x}"].full() for x in state)])
        found[-1] += [second[f"jac_adj_{x}_{y}"].full() for x in state for y in state]
    for other in found[1:]:
        for ours, theirs in zip(found[0], other, strict=True):
            assert theirs == pytest.approx(ours, rel=1e-12, abs=1e-12)
