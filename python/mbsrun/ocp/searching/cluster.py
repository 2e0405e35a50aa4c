"""Execute trials in many processes: send orders to the workers of a Dask cluster, and collect their outcomes.

A worker receives the generated C of a model, as a kit, and compiles it into its cache, once. So a worker needs this
program and a C compiler, but no model file and no shared file system. It builds one program for each structure.
"""

from __future__ import annotations

import hashlib
import itertools
import logging
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any, Generic, TypeVar

from mbsgen.errors import MbsError
from mbsrun.cache import MODELS, find_or_make
from mbsrun.environment import describe_environment
from mbsrun.external import Mechanism
from mbsrun.ocp.searching.executor import LocalExecutor, Worker
from mbsrun.ocp.searching.search import Executor, Job, Outcome

PATIENCE = 60  # s; how long a cluster waits for a worker
AHEAD = 2  # orders sent to each worker in advance, so that it never waits for the next
HERE = "127.0.0.1:0"  # the address of Dask's status pages: any port, for this machine alone
_FILE = re.compile(r"[A-Za-z0-9_]+\.(c|h|json)", re.ASCII)


Sent = TypeVar("Sent")
Order = TypeVar("Order")
Found = TypeVar("Found")


class ClusterError(MbsError):
    """The cluster is unreachable, or one of its workers failed."""


@dataclass(frozen=True)
class Kit:
    """The generated files of a model."""

    key: str  # names their content
    files: tuple[tuple[str, bytes], ...]

    def unpack(self, folder: Path) -> Path:
        """Write the files to a new folder in `folder`, and return it. Raises ClusterError for a bad name."""
        made = folder / "generated"
        made.mkdir()
        for name, content in self.files:
            if not _FILE.fullmatch(name):
                raise ClusterError(f"{name!r} is not the name of a generated file")
            (made / name).write_bytes(content)
        return made


def pack_kit(folder: Path) -> Kit:
    """Read the files of a generated folder that the kernels are compiled from."""
    files = tuple((path.name, path.read_bytes()) for path in sorted(folder.iterdir()) if _FILE.fullmatch(path.name))
    digest = hashlib.sha256()
    for name, content in files:
        digest.update(f"{name} {len(content)}\n".encode())
        digest.update(content)
    return Kit(digest.hexdigest()[:40], files)


class ClusterExecutor(Generic[Sent, Order, Found]):
    """Executes orders on the workers of a cluster: there, a function gets what is sent once, and an order."""

    def __init__(self, client: Any, kit: Sent, function: Callable[[Sent, Order], Found]) -> None:
        """Take a connected `distributed.Client`."""
        self._client, self._kit, self._function = client, kit, function

    def carry_out(self, orders: Iterable[Order]) -> Iterator[Found]:
        """Keep all workers busy, and yield outcomes as they come. Raises ClusterError where a worker fails."""
        from distributed import as_completed

        left = iter(orders)
        kit = self._client.scatter(self._kit, hash=False)
        under_way = as_completed()

        def submit(count: int) -> None:
            for order in itertools.islice(left, count):
                under_way.add(self._client.submit(self._function, kit, order, pure=False))

        submit(AHEAD * max(1, sum(self._client.nthreads().values())))
        for future in under_way:
            try:
                outcome: Found = future.result()
            except Exception as error:  # any error of a worker, or its end
                raise ClusterError(f"a worker of the cluster failed: {type(error).__name__}: {error}") from None
            submit(1)
            yield outcome


def carry_out(kit: Kit, order: Job) -> Outcome:
    """Make an attempt, in a process of the cluster."""
    if kit.key not in _WORKERS:
        folder = find_or_make(PurePath(MODELS, kit.key), kit.unpack)
        _WORKERS[kit.key] = Worker(Mechanism(folder), describe_environment())
    return _WORKERS[kit.key].carry_out(order)


_WORKERS: dict[str, Worker] = {}  # in this process, by the key of the kit


@contextmanager
def open_workers(workers: int, scheduler: str | None) -> Iterator[Callable[[Path], Executor]]:
    """Open workers: processes on this machine, or a cluster; with 0 workers, this process.

    Yields a function that returns the executor for a generated folder. Raises ClusterError.
    """
    if scheduler is None and workers == 0:
        yield lambda folder: LocalExecutor(Mechanism(folder), describe_environment())
        return
    with open_client(workers, scheduler) as client:
        yield lambda folder: ClusterExecutor(client, pack_kit(folder), carry_out)


@contextmanager
def open_client(workers: int, scheduler: str | None) -> Iterator[Any]:
    """Open a client of a cluster, by default of processes on this machine. Raises ClusterError."""
    try:
        import distributed
    except ImportError:
        raise ClusterError(
            "this needs Dask: run pip install '.[study]' in the folder of the project; "
            "or take this process alone: --workers 0"
        ) from None
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # it warns that solving keeps workers busy
    with _connect(distributed, scheduler) if scheduler else _start(distributed, workers) as client:
        yield client


@contextmanager
def _start(distributed: Any, workers: int) -> Iterator[Any]:
    """Start processes on this machine, with one thread each; they end with this process."""
    settings: dict[str, Any] = {"threads_per_worker": 1, "processes": True, "memory_limit": 0}
    settings |= dict.fromkeys(("dashboard_address", "worker_dashboard_address"), HERE)
    with (
        distributed.LocalCluster(n_workers=workers, host="127.0.0.1", silence_logs=logging.CRITICAL, **settings) as own,
        distributed.Client(own) as client,
    ):
        yield client


@contextmanager
def _connect(distributed: Any, scheduler: str) -> Iterator[Any]:
    """Connect to a cluster, and wait for a worker."""
    try:
        client = distributed.Client(scheduler, timeout=PATIENCE)
        client.wait_for_workers(1, timeout=PATIENCE)
    except (OSError, ValueError, TimeoutError) as error:
        raise ClusterError(
            f"--scheduler {scheduler}: no cluster with a worker answers: {error}; check the address"
        ) from None
    with client:
        yield client
