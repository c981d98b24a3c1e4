"""Interface between a model of the transport and the adaptive loop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, Self

from rfpipe.array_types import Bools
from rfpipe.methods.images import Pictures
from rfpipe.methods.residual.model import CameraCells, ProjectorCells
from rfpipe.transport.base import Transport
from rfpipe.transport.sum import SumTransport


class AdaptiveModel(Protocol):
    """Model of the transport that the adaptive loop fits; implementations are frozen.

    It begins with the floodlit picture alone, from which it already estimates a transport.
    """

    @property
    def counts(self) -> Mapping[str, int]:
        """Entries of the round's row in the table of levels, see `Transport.level_rows`.

        The table has the columns of a hierarchy; ``nodes`` is the number of the model's cores.
        """

    @property
    def is_suitable(self) -> bool:
        """False if the scene or rig can't be described by the model."""

    def next_patterns(self, key: int, count: int) -> Bools:
        """Draw random patterns, bool (count, *projector_shape); they differ between keys."""

    def prepared(self, pictures: Pictures) -> Any:
        """Return pictures as `fit` takes them: a dataclass of arrays, pictures first."""

    def taken(self, prepared: Any, lit: Bools) -> Pictures | None:
        """Return `prepared` pictures of the patterns `lit` (P, N) as they were taken.

        None if that isn't known: the model keeps sums over cells, or subtracts a prior's light.
        """

    def fit(self, pictures: Sequence[Any]) -> Self:
        """Fit the model to all `prepared` pictures so far; the first of them is floodlit."""

    def transport(
        self,
        rows: list[dict[str, Any]],
        residual: Sequence[Transport] = (),
    ) -> SumTransport:
        """Assemble the transport.

        Parameters
        ----------
        rows : list of dict
            The transport's table of levels.
        residual : sequence of Transport
            Further parts.
        """

    def dark_pixels(self, lit: Bools) -> Bools:
        """Find the camera pixels (P, M) without direct light under patterns (P, N)."""

    def projector_cells(self, camera: CameraCells, base: Transport) -> ProjectorCells:
        """Return the projector's cells for the residual of a transport."""
