"""A dask cluster of two workers, which tests kill one after the other."""

from typing import Any

import dask
from tests.services.waiting import PATIENCE_SECONDS


def kept_workers() -> Any:
    """Keep workers that die twice, for a block.

    Some time after a worker died dask looks whether it is back, and drops it for ever if another
    test has just killed it again.
    """
    return dask.config.set({"distributed.deploy.lost-worker-timeout": "1 hour"})


def address_of(cluster: Any) -> str:
    """Return the scheduler's address once both workers are there, whoever was killed before."""
    cluster.wait_for_workers(2, timeout=PATIENCE_SECONDS)
    return str(cluster.scheduler_address)
