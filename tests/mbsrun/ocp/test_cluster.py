"""Orders on a cluster, with a client that executes them here: kits, how far ahead orders are sent, and failures."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from mbsrun.ocp.searching import cluster
from mbsrun.ocp.searching.cluster import (
    AHEAD,
    HERE,
    PATIENCE,
    ClusterError,
    ClusterExecutor,
    Kit,
    open_client,
    open_workers,
    pack_kit,
)
from mbsrun.ocp.searching.executor import LocalExecutor


class Future:
    """An order that is executed when its result is asked for."""

    def __init__(self, function: Callable[[], Any]) -> None:
        self.result = function


class Queue:
    """Futures as they are completed: in the order in which they are added."""

    def __init__(self) -> None:
        self.left: list[Future] = []

    def add(self, future: Future) -> None:
        self.left.append(future)

    def __iter__(self) -> Iterator[Future]:
        while self.left:
            yield self.left.pop(0)


class Client:
    """A cluster of two workers, of three threads together."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        self.arguments, self.options, self.sent = arguments, options, list[Any]()
        self.threads, self.waited = {"a": 1, "b": 2}, list[Any]()
        self.is_closed = False

    def scatter(self, kit: Any, hash: bool) -> Any:
        assert not hash, "equal kits may differ in type"
        return [kit]

    def nthreads(self) -> dict[str, int]:
        return self.threads

    def submit(self, function: Callable[..., Any], kit: Any, order: Any, pure: bool) -> Future:
        assert not pure, "orders that are equal are executed each"
        self.sent.append(order)
        return Future(lambda: function(kit[0], order))

    def wait_for_workers(self, count: int, timeout: float) -> None:
        self.waited.append((count, timeout))

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.is_closed = True


@pytest.fixture
def dask(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Put a cluster of this process in Dask's place."""
    module = SimpleNamespace(as_completed=Queue, Client=Client)
    monkeypatch.setitem(sys.modules, "distributed", module)
    return module


@pytest.mark.usefixtures("dask")
@pytest.mark.parametrize(("threads", "ahead"), [({"a": 1, "b": 2}, 3 * AHEAD), ({}, AHEAD)])
def test_orders_are_sent_ahead_and_one_for_each_outcome(threads: dict[str, int], ahead: int) -> None:
    """Two for each thread; a cluster whose workers are not there yet counts as one thread."""
    client = Client()
    client.threads = threads

    def add(kit: int, order: int) -> int:
        return kit + order

    found = ClusterExecutor(client, 100, add).carry_out(range(20))
    assert [next(found), next(found), next(found)] == [100, 101, 102]
    assert client.sent == list(range(ahead + 3))
    assert list(found) == list(range(103, 120))
    assert client.sent == list(range(20))


@pytest.mark.usefixtures("dask")
def test_a_worker_that_fails_is_named() -> None:
    def fail(_: int, order: int) -> int:
        return 1 // order

    found = ClusterExecutor(Client(), 0, fail).carry_out([1, 0])
    assert next(found) == 1
    with pytest.raises(ClusterError, match=r"a worker of the cluster failed: ZeroDivisionError: "):
        next(found)


def test_a_kit_holds_the_generated_files_under_the_name_of_their_content(tmp_path: Path) -> None:
    """Other files are left out; names and content both count."""
    folder = tmp_path / "model"
    folder.mkdir()
    for name, text in {"b.c": "two", "a.h": "one", "manifest.json": "{}", "notes.txt": "x", "a b.c": "x"}.items():
        (folder / name).write_text(text, encoding="utf-8")
    kit = pack_kit(folder)
    assert kit.files == (("a.h", b"one"), ("b.c", b"two"), ("manifest.json", b"{}"))
    assert len(kit.key) == 40
    (folder / "notes.txt").write_text("y", encoding="utf-8")
    assert pack_kit(folder) == kit
    (folder / "b.c").write_text("tw0", encoding="utf-8")
    assert pack_kit(folder).key != kit.key
    (folder / "b.c").rename(folder / "c.c")
    assert pack_kit(folder).key not in (kit.key, "")
    made = kit.unpack(tmp_path)
    assert made == tmp_path / "generated"
    assert {path.name: path.read_bytes() for path in made.iterdir()} == dict(kit.files)


@pytest.mark.parametrize("name", ["../a.c", "a.py", "a.c.exe", "ä.c", ""])
def test_a_kit_writes_generated_files_alone(tmp_path: Path, name: str) -> None:
    with pytest.raises(ClusterError, match="is not the name of a generated file"):
        Kit("key", ((name, b""),)).unpack(tmp_path)


def test_a_worker_is_made_once_for_a_kit(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Any] = []

    def make(mechanism: Any, _: Any) -> Any:
        made.append(mechanism)
        return SimpleNamespace(carry_out=lambda order: (mechanism, order))

    monkeypatch.setattr(cluster, "_WORKERS", {})
    monkeypatch.setattr(cluster, "find_or_make", lambda path, _: path.name)
    monkeypatch.setattr(cluster, "Mechanism", lambda folder: folder)
    monkeypatch.setattr(cluster, "Worker", make)
    orders: Any = [1, 2, 3]
    found: Any = [cluster.carry_out(Kit(key, ()), order) for key, order in zip("aba", orders, strict=True)]
    assert found == [("a", 1), ("b", 2), ("a", 3)]
    assert made == ["a", "b"]


@pytest.mark.usefixtures("dask")
def test_a_cluster_is_asked_for_a_worker() -> None:
    with open_client(3, "tcp://there:1") as client:
        assert client.arguments == ("tcp://there:1",)
        assert client.options == {"timeout": PATIENCE}
        assert client.waited == [(1, PATIENCE)]
        assert not client.is_closed
    assert client.is_closed


@pytest.mark.parametrize("error", [OSError("gone"), ValueError("gone"), TimeoutError("gone")])
def test_a_cluster_without_a_worker_is_refused(dask: SimpleNamespace, error: Exception) -> None:
    def fail(*_: Any, **__: Any) -> None:
        raise error

    dask.Client = fail
    with pytest.raises(ClusterError, match="--scheduler there: no cluster with a worker answers: gone; check"):
        open_client(0, "there").__enter__()


def test_processes_of_this_machine_have_one_thread_and_show_no_page_to_others(dask: SimpleNamespace) -> None:
    begun: list[dict[str, Any]] = []

    class Cluster(Client):
        """Keeps how it was begun."""

        def __init__(self, **options: Any) -> None:
            super().__init__(**options)
            begun.append(options)

    dask.LocalCluster = Cluster
    with open_client(3, None) as client:
        (own,) = client.arguments
        assert isinstance(own, Cluster)
    assert own.is_closed
    assert client.is_closed
    (options,) = begun
    assert options["n_workers"] == 3
    assert options["host"] == HERE.partition(":")[0] == "127.0.0.1"
    assert options["threads_per_worker"] == 1
    assert options["processes"] is True
    assert options["memory_limit"] == 0
    assert options["dashboard_address"] == options["worker_dashboard_address"] == HERE


def test_without_dask_the_error_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ClusterError, match=r"this needs Dask: run pip install .* --workers 0"):
        open_client(2, None).__enter__()


def test_no_workers_are_this_process(monkeypatch: pytest.MonkeyPatch, dask: SimpleNamespace) -> None:
    """Unless there is a scheduler; then, and with workers, orders go to a cluster."""
    monkeypatch.setattr(cluster, "Mechanism", lambda _: "mechanism")
    monkeypatch.setattr(cluster, "pack_kit", lambda _: "kit")
    dask.LocalCluster = Client
    for workers, scheduler, kind in (
        (0, None, LocalExecutor),
        (0, "there", ClusterExecutor),
        (2, None, ClusterExecutor),
    ):
        with open_workers(workers, scheduler) as make:
            assert isinstance(make(Path()), kind)
