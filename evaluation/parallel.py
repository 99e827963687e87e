"""Independent calls on several processes of this machine, or on the workers of a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from estimation.errors import InputError, WhereaboutsError

Result = TypeVar("Result")
LOCAL = "local:"
CONNECT_TIMEOUT = 10.0


class ClusterError(WhereaboutsError):
    """There is no Dask here, nobody answers at the address, or the cluster has no worker."""


def each(
    function: Callable[..., Result], calls: Iterable[tuple[Any, ...]], jobs: int = 1, what: str = ""
) -> list[Result]:
    """The function's results for each tuple of arguments, in order.

    They do not depend on where they are computed: a call that draws at random takes a seed.

    jobs : processes on this machine; inside `cluster` the workers of the cluster are used instead.
    what : if given, the label of a progress bar.
    """
    from joblib import Parallel, delayed

    from whereabouts.system.progress import track

    given = list(calls)
    results = Parallel(n_jobs=jobs, return_as="generator")(delayed(function)(*call) for call in given)
    return list(track(results, what, len(given)) if what else results)


@contextmanager
def cluster(address: str) -> Iterator[int]:
    """Run what `each` and joblib are given inside the block on a Dask cluster; gives the number of its threads.

    address : of the scheduler, such as "tcp://10.0.0.5:8786"; "local:2" starts two workers on this machine for as long
        as the block lasts; "" stays in this process.

    Raises
    ------
    ClusterError : Dask is not installed, the scheduler does not answer, or has no workers.
    InputError : the address is neither.
    """
    if not address:
        yield 1
        return
    try:
        import distributed
    except ImportError as error:
        raise ClusterError(
            "--dask needs dask.distributed, which is optional: `pip install -r requirements/evaluation.txt`, or "
            f"`pip install 'dask[distributed]'` ({error})"
        ) from None
    from joblib import parallel_config

    with _client(distributed, address) as client:
        threads = sum(client.nthreads().values())
        if not threads:
            raise ClusterError(
                f"the cluster at {address} has no workers: start some with `dask worker {address}`"
            )
        with parallel_config(backend="dask", client=client):
            yield threads


@contextmanager
def _client(distributed: Any, address: str) -> Iterator[Any]:
    if address.startswith(LOCAL):
        count = address.removeprefix(LOCAL)
        if not count.isdigit() or not int(count):
            raise InputError(f"--dask: local:NUMBER expected, got {address!r}")
        settings = {"n_workers": int(count), "threads_per_worker": 1, "dashboard_address": None}
        with distributed.LocalCluster(**settings) as workers, distributed.Client(workers) as client:
            yield client
        return
    if "://" not in address:
        raise InputError(
            f"--dask: an address such as tcp://10.0.0.5:8786 or local:2 expected, got {address!r}"
        )
    try:
        client = distributed.Client(address, timeout=CONNECT_TIMEOUT)
    except (OSError, TimeoutError, ValueError) as error:
        raise ClusterError(f"no Dask scheduler answers at {address}: {error}") from None
    with client:
        yield client
