"""Settings and address of the dask cluster whose workers the tests kill."""

from typing import Any

import dask
from tests.services.waiting import PATIENCE_SECONDS


def kept_workers() -> Any:
    """Return a context in which dask restarts workers however often they die.

    By default dask checks some time after a worker's death whether it is alive, and removes it for
    good if another test has killed it again.
    """
    return dask.config.set({"distributed.deploy.lost-worker-timeout": "1 hour"})


def address_of(cluster: Any) -> str:
    """Wait until both workers are running, and return the address of the scheduler."""
    cluster.wait_for_workers(2, timeout=PATIENCE_SECONDS)
    return str(cluster.scheduler_address)
