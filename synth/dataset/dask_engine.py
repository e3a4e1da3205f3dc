"""Units of work in, their records out, by the workers of a Dask cluster: one of this machine, or one that runs already.

Workers write what they make themselves, so that a remote cluster has to reach the scene's files and the store under
the names that this process knows them by. A worker that is lost is replaced by another one: what it had begun is made
again.
"""

import ipaddress
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from handtrack.errors import InputError

from .engine import GO_ON, ONE_THREAD, Stopped, T
from .plan import Unit

if TYPE_CHECKING:
    from distributed import Client

_AHEAD = 2  # units for each worker that are handed out
_SECONDS = "20s"  # to reach a scheduler


def dasked(
    task: Callable[[Unit], T], todo: Sequence[Unit], workers: int, scheduler: str | None = None, remote: bool = False
) -> Iterator[T]:
    """Units as the workers of a cluster finish them.

    Parameters
    ----------
    workers : int
        Processes of a cluster on this machine, one thread each; a cluster that runs already has its own.
    scheduler : str, optional
        Address of one that runs already, `tcp://127.0.0.1:8786`.
    remote : bool
        Whether the address may be that of another machine.

    Raises
    ------
    InputError
        If the package is missing, or the address is bad or of another machine.
    Stopped
        If the scheduler does not answer, or work is lost again and again.
    """
    try:
        import distributed
        from distributed.comm.core import CommClosedError
    except ImportError as error:
        raise InputError("--engine dask: needs a package that is missing; install handtrack[dask]") from error
    if workers < 1:
        raise ValueError(f"workers: {workers}; at least 1 was wanted")
    if scheduler is not None:
        check_address(scheduler, remote)
    try:
        with _client(scheduler, min(workers, max(1, len(todo)))) as client:
            known: Any = client.nthreads()
            ahead = _AHEAD * max(1, len(known))
            yield from _rolling(client, task, todo, ahead)
    except distributed.KilledWorker as error:
        raise Stopped(f"workers of the Dask cluster were lost again and again (out of memory?); {GO_ON}") from error
    except (CommClosedError, TimeoutError) as error:
        where = "" if scheduler is None else f" at {scheduler}"
        raise Stopped(f"the Dask scheduler{where} does not answer; {GO_ON}") from error


def check_address(scheduler: str, remote: bool) -> None:
    """Make sure that a scheduler's address can be used.

    Raises
    ------
    InputError
        If it is none, or that of another machine while that was not allowed.

    >>> check_address("tcp://127.0.0.1:8786", remote=False)
    """
    try:
        parts = urlsplit(scheduler if "://" in scheduler else f"tcp://{scheduler}")
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
    if not host or port is None:
        raise InputError(f"--scheduler: {scheduler!r}; an address such as tcp://127.0.0.1:8786 was wanted")
    if not remote and not _loopback(host):
        raise InputError(f"--scheduler: {host} is not this machine; say --allow-remote if its network can be trusted")


def _loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


@contextmanager
def _client(scheduler: str | None, workers: int) -> Iterator["Client"]:
    """A connection, to a cluster of this machine where no address is given."""
    from dask import config
    from distributed import Client, LocalCluster

    quiet = {
        "distributed.scheduler.worker-ttl": None,  # compiled loops may keep a worker from answering
        "distributed.comm.timeouts.connect": _SECONDS,
        "distributed.scheduler.active-memory-manager.start": False,
    }
    with config.set(quiet):
        if scheduler is not None:
            with Client(scheduler, timeout=_SECONDS, set_as_default=False) as client:
                yield client
            return
        with (
            LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address=None,  # type: ignore[arg-type]
                worker_dashboard_address=None,
                memory_limit=0,
                silence_logs=50,
                env=dict.fromkeys(ONE_THREAD, "1"),
            ) as cluster,
            Client(cluster, set_as_default=False) as client,
        ):
            yield client


def _rolling(client: "Client", task: Callable[[Unit], T], todo: Sequence[Unit], ahead: int) -> Iterator[T]:
    """Hand out a few units at a time, whatever their number."""
    from distributed import as_completed

    rest = iter(todo)
    first = list(islice(rest, ahead))
    if not first:
        return
    running: Any = as_completed([_submitted(client, task, unit) for unit in first], loop=client.loop)
    for future in running:
        yield future.result()
        future.release()
        unit = next(rest, None)
        if unit is not None:
            running.add(_submitted(client, task, unit))


def _submitted(client: "Client", task: Callable[[Unit], T], unit: Unit) -> Any:
    return client.submit(task, unit, key=f"unit-{unit.name}-{id(client)}", pure=False)
