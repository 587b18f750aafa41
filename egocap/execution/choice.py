"""The executor that `--workers` and `--cluster` ask for."""

from __future__ import annotations

from egocap.errors import InputError
from egocap.execution.jobs import Executor, InProcess
from egocap.execution.process_pool import ProcessPool


def choose_executor(workers: int, cluster: str | None) -> Executor:
    """This process for 0 workers, local processes, or the workers of a Dask scheduler's address."""
    if workers < 0:
        raise InputError(f"{workers} workers", valid="0 or more")
    if cluster is not None:
        from egocap.execution.cluster import DaskCluster

        return DaskCluster(cluster)
    return ProcessPool(workers) if workers else InProcess()
