"""Projectors with ViALUX' ALP controllers for micromirrors, through ALP4lib and ViALUX' library.

Tested with an emulation of the library's functions, written from its header, not with hardware.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from rfpipe.array_types import Codes
from rfpipe.config.base import Settings, Text
from rfpipe.devices.bracket import load_library
from rfpipe.devices.dmd import DmdProjector
from rfpipe.errors import CaptureError

Version = Literal["4.1", "4.2", "4.3", "4.4", "5.0", "5.1"]

MAX_PICTURES = 500
"""Pictures loaded at a time: indices in the controller's look-up table have 9 bits."""


class AlpOptions(Settings):
    """A projector with ViALUX' ALP controller."""

    version: Version = Field("4.3", description="Version of ViALUX' ALP library.")
    folder: Text | None = Field(
        None, description="Folder of the ALP library, or null for the folder of its installation."
    )
    serial: int | None = Field(
        None, ge=1, description="Serial number of the controller, or null for the first one."
    )
    settle_seconds: float = Field(
        0.02, ge=0, le=60, description="Wait after loading and starting a picture, in seconds."
    )


class AlpProjector(DmdProjector):
    """A projector of 8-bit pictures, and of sequences of binary pictures that trigger the camera.

    The frame synch output is active in the first half of each picture: connect it to the input that
    the camera's settings name. `AlpOptions` lists the options. CaptureError where ALP4lib or
    ViALUX' library is missing, or no controller responds.
    """

    Options = AlpOptions

    def __init__(
        self,
        version: Version = "4.3",
        folder: str | None = None,
        serial: int | None = None,
        settle_seconds: float = 0.02,
    ) -> None:
        super().__init__(settle_seconds)
        self._api = load_library("ALP4", "alp")
        self._sequence: Any = None
        try:
            self._alp = self._api.ALP4(version, folder)
        except (OSError, ValueError) as error:
            raise CaptureError(
                f"projector: ViALUX' ALP library {version} can't be loaded: {error}. Install it, "
                "and set projector.options.version and folder"
            ) from error
        with self._errors():
            self._alp.Initialize(serial)
            memory = self._alp.DevInquire(self._api.ALP_AVAIL_MEMORY)
        self.shape = self._alp.nSizeY, self._alp.nSizeX
        self.sequence_pictures = min(MAX_PICTURES, memory)

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: all that shapes the light."""
        return {"kind": "alp", "shape": list(self.shape)}

    def _show(self, codes: Codes, bits: int) -> None:
        with self._errors():
            self._allocate(1, bits)
            self._put(codes if bits > 1 else 255 * codes, 0)
            # grey at the shortest period, so that exposures average its bits
            least = self._alp.SeqInquire(self._api.ALP_MIN_PICTURE_TIME, self._sequence)
            self._alp.SetTiming(self._sequence, pictureTime=least)
            self._alp.Run(self._sequence, loop=True)

    def _load(self, pictures: Iterator[NDArray[np.bool_]]) -> None:
        packed = [np.packbits(picture, axis=1) for picture in pictures]  # limits memory
        with self._errors():
            self._allocate(len(packed), bits=1)
            for index, rows in enumerate(packed):
                lit = np.unpackbits(rows, axis=1, count=self.shape[1])
                self._put(255 * lit, index)

    def _microseconds(self) -> tuple[int, int]:
        if self._sequence is None:
            raise CaptureError("projector: no pictures are loaded")
        with self._errors():
            limits = self._api.ALP_MIN_PICTURE_TIME, self._api.ALP_MAX_PICTURE_TIME
            least, longest = (self._alp.SeqInquire(limit, self._sequence) for limit in limits)
        return least, longest

    def _play(self, order: Sequence[int], microseconds: int) -> None:
        api, alp = self._api, self._alp
        table = np.zeros(2 + 4096, np.int32)  # tFlutWrite: offset, number of entries, entries
        table[1], table[2 : 2 + len(order)] = len(order), order
        with self._errors():
            pulse = microseconds // 2
            alp.SetTiming(self._sequence, pictureTime=microseconds, synchPulseWidth=pulse)
            alp.SeqControl(api.ALP_FLUT_MODE, api.ALP_FLUT_9BIT, self._sequence)
            alp.SeqControl(api.ALP_FLUT_ENTRIES9, len(order), self._sequence)
            alp.ProjControlEx(api.ALP_FLUT_WRITE_9BIT, table.ctypes.data_as(ctypes.c_void_p))
            alp.Run(self._sequence, loop=False)
            alp.Wait()
            alp.Halt()

    def _allocate(self, count: int, bits: int) -> None:
        """Stop the display, and allocate memory for pictures in place of the previous ones."""
        self._alp.Halt()
        previous, self._sequence = self._sequence, None
        if previous is not None:
            self._alp.FreeSeq(previous)
        self._sequence = self._alp.SeqAlloc(count, bits)
        if bits == 1:  # without a dark time between pictures
            mode = self._api.ALP_BIN_MODE, self._api.ALP_BIN_UNINTERRUPTED
            self._alp.SeqControl(*mode, self._sequence)

    def _put(self, codes: Codes, index: int) -> None:
        """Load codes (H, W), aligned to the highest of 8 bits."""
        self._alp.SeqPut(np.ascontiguousarray(codes), self._sequence, PicOffset=index, PicLoad=1)

    def _release(self) -> None:
        with suppress(self._api.ALPError):
            self._alp.Halt()
            self._alp.Free()

    @contextmanager
    def _errors(self) -> Iterator[None]:
        """Raise errors of the controller as CaptureError."""
        try:
            yield
        except self._api.ALPError as error:
            raise CaptureError(
                f"projector: {str(error).rstrip('.')}. Check its power and cable, and that no "
                "other program uses it"
            ) from error
