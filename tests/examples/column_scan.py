"""A user-defined method in one file: a scan of the projector by whole columns.

It assumes that all rays of a projector column have equal transport, as in a scene that doesn't
change from top to bottom, and shows one pattern per projector column.
"""

from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field

from rfpipe.methods import Method, Options, StateArrays
from rfpipe.patterns import Schedule
from rfpipe.transport.dense import DenseTransport


class ColumnOptions(Options):
    """Options of the scan."""

    width: int = Field(1, ge=1, le=64, description="Columns lit together, 1 to 64.")


@dataclass(frozen=True)
class ColumnState:
    """Rays, options, the transport so far and the table of levels."""

    camera: tuple[int, ...]
    projector: tuple[int, ...]
    options: ColumnOptions
    matrix: np.ndarray  # (C, camera rays, projector rays)
    rows: tuple[dict[str, int], ...] = ()

    def to_arrays(self, previous):
        return StateArrays({"matrix": self.matrix}, {"rows": list(self.rows)})

    @classmethod
    def from_arrays(cls, start, levels):
        if not levels:
            return start
        last = levels[-1]
        return replace(start, matrix=last.arrays["matrix"], rows=tuple(last.attributes["rows"]))


class ColumnScan(Method[ColumnState]):
    """A scan of the projector's columns."""

    name = "column_scan"
    title = "Scan of columns"
    colour = "#2f7f7f"
    Options = ColumnOptions

    def forecast(self, camera, projector, channels, options):
        patterns = -(-projector.shape[-1] // options.width)
        return self.forecast_of(camera, channels, patterns, patterns)

    def start(self, camera, projector, channels, options):
        matrix = np.zeros((channels, camera.size, projector.size), np.float32)
        return ColumnState(camera.shape, projector.shape, options, matrix)

    def next_schedule(self, state):
        if state.rows:  # its only level is shown
            return None
        column = np.arange(state.projector[-1], dtype=np.int32) // state.options.width
        pattern_of_ray = np.broadcast_to(column, state.projector).copy()
        count = int(column.max()) + 1
        return Schedule(0, state.projector, count, pattern_of_ray=pattern_of_ray, complete=True)

    def refine(self, state, images, memory_bytes=0):
        schedule = images.schedule
        pattern = schedule.pattern_of_ray.ravel()
        radiance, _ = images.read(0, schedule.count)
        columns = radiance.reshape(schedule.count, -1, len(state.matrix))
        matrix = np.moveaxis(columns, (0, 2), (2, 0))[:, :, pattern] / np.bincount(pattern)[pattern]
        row = dict.fromkeys(("level", "empty", "rank1", "subdivided"), 0)
        row |= {"patterns": schedule.count, "nodes": schedule.count, "scalar": schedule.count}
        return replace(state, matrix=matrix.astype(np.float32), rows=(row,))

    def transport(self, state):
        arrays = {"matrix": state.matrix}
        rows = list(state.rows)
        return DenseTransport(state.camera, state.projector, len(state.matrix), rows, arrays)
