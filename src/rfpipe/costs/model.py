"""Laws of what a job takes: a constant and a power of its pictures' size, for each method.

The constant is what Python with its libraries takes. The power is the one of a few that tells
records best that it wasn't fitted to, so that a method whose matrix is dense, and one that keeps
blocks, each gets its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from math import exp, log
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rfpipe.costs.records import Record

__all__ = ["Law", "Laws", "Quantity", "fit_law", "fit_laws"]

Quantity = Literal["memory_mb", "cpu_seconds"]

_Key = tuple[str, str, bool]
"""Job, method, and whether it is of an array of views."""

_POWERS = (0.5, 0.75, 1.0, 1.25, 1.5, 2.0)

# Records of jobs of a like size tell how this machine, and these scenes, differ from the table's.
_LIKE = 8.0


@dataclass(frozen=True)
class Law:
    """``constant + slope * samples**power``.

    Parameters
    ----------
    constant, slope : float
        At least 0.
    power : float
    largest : int
        Samples of the largest record that it was fitted to; beyond, it is extrapolated.
    """

    constant: float
    slope: float
    power: float
    largest: int

    def __call__(self, samples: float) -> float:
        """Return what a job of pictures of so many samples takes."""
        return self.constant + self.slope * float(samples**self.power)


@dataclass(frozen=True)
class Laws:
    """What jobs take, as the shipped records and those at hand tell.

    Parameters
    ----------
    laws : mapping
        For each quantity and kind of job.
    nearby : sequence of Record
        From the same machine and project; they correct the laws.
    """

    laws: Mapping[tuple[Quantity, _Key], Law]
    nearby: Sequence[Record] = field(default=())

    def predict(
        self, quantity: Quantity, job: str, method: str, samples: int, *, views: int = 1
    ) -> float | None:
        """Return what a job will take, None where nothing is known of such jobs.

        A method that isn't in the table is taken for the dearest that is.

        Parameters
        ----------
        quantity : {"memory_mb", "cpu_seconds"}
        job : str
            One of `rfpipe.costs.records.JOBS`.
        method : str
        samples : int
            Numbers in a picture of the camera's: rays times channels.
        views : int
        """
        law = self._law(quantity, job, method, views > 1)
        if law is None:
            return None
        key = job, method, views > 1
        logs = [
            log(getattr(one, quantity) / law(one.samples))
            for one in self.nearby
            if _key(one) == key and 1 / _LIKE <= one.samples / samples <= _LIKE
        ]
        return law(samples) * (exp(sum(logs) / len(logs)) if logs else 1.0)

    def _law(
        self, quantity: Quantity, job: str, method: str, is_field: bool
    ) -> Callable[..., float] | None:
        for key in ((job, method, is_field), (job, method, not is_field)):
            if (quantity, key) in self.laws:
                return self.laws[quantity, key]
        others = [
            law for (what, key), law in self.laws.items() if (what, key[0]) == (quantity, job)
        ]
        if not others:
            return None
        return lambda samples: max(law(samples) for law in others)


def fit_laws(records: Iterable[Record], nearby: Sequence[Record] = ()) -> Laws:
    """Fit the laws of all kinds of jobs in some records; see `Laws` for `nearby`."""
    laws: dict[tuple[Quantity, _Key], Law] = {}
    quantities: tuple[Quantity, ...] = ("memory_mb", "cpu_seconds")
    for key, group in groupby(sorted(records, key=_key), _key):
        of_kind = list(group)
        samples = np.array([one.samples for one in of_kind], np.float64)
        for quantity in quantities:
            taken = np.array([getattr(one, quantity) for one in of_kind])
            laws[quantity, key] = fit_law(samples, taken)
    return Laws(laws, nearby)


def fit_law(samples: NDArray[np.float64], taken: NDArray[np.float64]) -> Law:
    """Return the law that tells each record best from those of other sizes.

    Parameters
    ----------
    samples, taken : ndarray of float64, shape (records,)
        Above 0.
    """
    largest = int(samples.max())
    if len(set(samples)) < 3:  # a power can't be told
        return Law(*_fit(samples, taken, 1.0), 1.0, largest)
    power = min(_POWERS, key=lambda power: _left_out(samples, taken, power))
    return Law(*_fit(samples, taken, power), power, largest)


def _left_out(samples: NDArray[np.float64], taken: NDArray[np.float64], power: float) -> float:
    """Return the mean squared error of the logarithms of records whose size was left out."""
    errors: list[float] = []
    for size in set(samples):
        others = samples != size
        constant, slope = _fit(samples[others], taken[others], power)
        expected = constant + slope * size**power
        errors.extend(np.log(np.maximum(expected, 1e-9) / taken[~others]) ** 2)
    return float(np.mean(errors))


def _fit(
    samples: NDArray[np.float64], taken: NDArray[np.float64], power: float
) -> tuple[float, float]:
    """Return constant and slope, neither negative, of the least relative errors."""
    from scipy.optimize import nnls

    columns = np.stack([np.ones_like(samples), samples**power], axis=1)
    scale = columns.max(axis=0)
    solution, _ = nnls(columns / scale / taken[:, None], np.ones_like(taken))
    constant, slope = solution / scale
    return float(constant), float(slope)


def _key(record: Record) -> _Key:
    return record.job, record.method, record.views > 1
