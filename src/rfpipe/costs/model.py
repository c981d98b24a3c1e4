"""Laws of what a job takes: a constant and a power of its pictures' size, for each method.

The constant is what Python with its libraries takes. The power is 1 unless another one of a few
tells records far better that it wasn't fitted to, so that a method whose matrix is dense gets its
own. What a simulated scene takes alone is known beforehand, and no part of a law.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from math import exp, log
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rfpipe.costs.records import LIKE, Record, Subject

__all__ = ["Law", "Laws", "Quantity", "fit_law", "fit_laws"]

Quantity = Literal["memory_mb", "cpu_seconds"]

_Key = tuple[str, str, bool]
"""Job, method, and whether it is of an array of views."""

_POWERS = (0.5, 0.75, 1.0, 1.25, 1.5, 2.0)
# Mean squared errors up to so many times the least tell no power from another: with few records
# the best of them is chance, and extrapolated far.
_AS_GOOD = 3.0


@dataclass(frozen=True)
class Law:
    """``constant + slope * size**power``.

    Parameters
    ----------
    constant, slope : float
        At least 0.
    power : float
    largest : float
        Size of the largest record that it was fitted to; beyond, it is extrapolated.
    """

    constant: float
    slope: float
    power: float
    largest: float

    def __call__(self, size: float) -> float:
        """Return what a job of pictures of a size takes."""
        return self.constant + self.slope * float(size**self.power)


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

    def predict(self, quantity: Quantity, job: str, subject: Subject) -> float | None:
        """Return what a job will take, None where nothing is known of such jobs.

        A method that isn't in the table is taken for the dearest of those that were measured at
        such a size.

        Parameters
        ----------
        quantity : {"memory_mb", "cpu_seconds"}
        job : str
            One of `rfpipe.costs.records.JOBS`.
        subject : Subject
        """
        law = self._law(quantity, job, subject)
        if law is None:
            return None
        key = job, subject.method, subject.views > 1
        logs = [
            log(_own(one, quantity) / law(one.subject.size))
            for one in self.nearby
            if _key(one) == key and subject.is_like(one.subject.size)
        ]
        own = law(subject.size) * (exp(sum(logs) / len(logs)) if logs else 1.0)
        return own + _simulated(quantity, job, subject)

    def _law(
        self, quantity: Quantity, job: str, subject: Subject
    ) -> Callable[[float], float] | None:
        is_field = subject.views > 1
        for key in ((job, subject.method, is_field), (job, subject.method, not is_field)):
            if (quantity, key) in self.laws:
                return self.laws[quantity, key]
        others = [
            law for (what, key), law in self.laws.items() if (what, key[0]) == (quantity, job)
        ]
        if not others:
            return None
        known = min(subject.size / LIKE, max(law.largest for law in others))
        others = [law for law in others if law.largest >= known]
        return lambda size: max(law(size) for law in others)


def fit_laws(records: Iterable[Record], nearby: Sequence[Record] = ()) -> Laws:
    """Fit the laws of all kinds of jobs in some records; see `Laws` for `nearby`."""
    laws: dict[tuple[Quantity, _Key], Law] = {}
    quantities: tuple[Quantity, ...] = ("memory_mb", "cpu_seconds")
    for key, group in groupby(sorted(records, key=_key), _key):
        of_kind = list(group)
        sizes = np.array([one.subject.size for one in of_kind], np.float64)
        for quantity in quantities:
            taken = np.array([_own(one, quantity) for one in of_kind])
            laws[quantity, key] = fit_law(sizes, taken)
    return Laws(laws, nearby)


def fit_law(sizes: NDArray[np.float64], taken: NDArray[np.float64]) -> Law:
    """Return the law that tells each record from those of other sizes.

    Parameters
    ----------
    sizes, taken : ndarray of float64, shape (records,)
        Above 0.
    """
    largest = float(sizes.max())
    if len(set(sizes)) < 3:  # a power can't be told
        return Law(*_fit(sizes, taken, 1.0), 1.0, largest)
    errors = {power: _left_out(sizes, taken, power) for power in _POWERS}
    good = [power for power in _POWERS if errors[power] <= _AS_GOOD * min(errors.values())]
    power = min(good, key=lambda power: abs(log(power)))
    return Law(*_fit(sizes, taken, power), power, largest)


def _left_out(sizes: NDArray[np.float64], taken: NDArray[np.float64], power: float) -> float:
    """Return the mean squared error of the logarithms of records whose size was left out."""
    errors: list[float] = []
    for size in set(sizes):
        others = sizes != size
        constant, slope = _fit(sizes[others], taken[others], power)
        expected = constant + slope * size**power
        errors.extend(np.log(np.maximum(expected, 1e-9) / taken[~others]) ** 2)
    return float(np.mean(errors))


def _fit(
    sizes: NDArray[np.float64], taken: NDArray[np.float64], power: float
) -> tuple[float, float]:
    """Return constant and slope, neither negative, of the least relative errors."""
    # in NumPy: a library's solver takes a second to load, each time that Snakemake starts
    columns = np.stack([np.ones_like(sizes), sizes**power], axis=1)
    scale = columns.max(axis=0)
    relative = columns / scale / taken[:, None]
    solution = np.linalg.lstsq(relative, np.ones_like(taken))[0]
    if np.ptp(sizes) == 0 or solution.min() < 0:  # the better one, alone: all here is positive
        alone = relative.sum(axis=0) / (relative**2).sum(axis=0)
        better = np.argmin(((relative * alone - 1) ** 2).sum(axis=0))
        solution = np.where(np.arange(2) == better, alone, 0.0)
    constant, slope = solution / scale
    return float(constant), float(slope)


def _simulated(quantity: Quantity, job: str, subject: Subject) -> float:
    return subject.simulation_of(job) if quantity == "memory_mb" else 0.0


def _own(record: Record, quantity: Quantity) -> float:
    """Return what a job took beside its simulated scene, or a tenth where that seems to be less."""
    taken = float(getattr(record, quantity))
    return max(taken - _simulated(quantity, record.job, record.subject), taken / 10)


def _key(record: Record) -> _Key:
    return record.job, record.method, record.views > 1
