"""Settings, exposure times and pictures of a photo camera through libgphoto2."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Iterable, Sequence
from contextlib import suppress
from itertools import pairwise
from typing import Any, NamedTuple

from rfpipe.devices.bracket import load_library
from rfpipe.errors import CaptureError, InputError

Setting = bool | int | float | str


def load_gphoto2() -> Any:
    """Return the module ``gphoto2``, or raise CaptureError."""
    return load_library("gphoto2", "gphoto2")


def list_cameras() -> list[tuple[str, str]]:
    """Return model and port of each connected camera."""
    cameras = load_gphoto2().Camera.autodetect()
    return [(cameras.get_name(index), cameras.get_value(index)) for index in range(cameras.count())]


class Photo:
    """An open camera, given model and port as in `list_cameras`.

    Constructor and methods raise gphoto2.GPhoto2Error where the camera fails.
    """

    def __init__(self, model: str, port: str) -> None:
        self._gp = load_gphoto2()
        ports, abilities = self._gp.PortInfoList(), self._gp.CameraAbilitiesList()
        ports.load()
        abilities.load()
        self._camera = self._gp.Camera()
        self._camera.set_port_info(ports.get_info(ports.lookup_path(port)))
        self._camera.set_abilities(abilities.get_abilities(abilities.lookup_model(model)))
        self._camera.init()

    def get(self, name: str) -> Setting | None:
        """Return the value of a setting; None where the camera has no such setting."""
        widget = self._widget(name)
        return None if widget is None else widget.get_value()

    def choices(self, name: str) -> list[str]:
        """List the valid values of a setting; empty if it doesn't exist or isn't a choice."""
        widget = self._widget(name)
        if widget is None or widget.get_type() not in (
            self._gp.GP_WIDGET_RADIO, self._gp.GP_WIDGET_MENU,
        ):  # fmt: skip
            return []
        return [widget.get_choice(index) for index in range(widget.count_choices())]

    def set(self, name: str, value: Setting) -> bool:
        """Write a setting; False where it doesn't exist or is read-only.

        CaptureError where the camera refuses the value.
        """
        widget = self._widget(name)
        if widget is None or widget.get_readonly():
            return False
        values = self.choices(name)
        if values and str(value) not in values:
            raise CaptureError(f"camera: {name} can't be {value}; it is one of {', '.join(values)}")
        if widget.get_value() == value:
            return True
        try:
            widget.set_value(value)
            self._camera.set_single_config(name, widget)
        except (TypeError, ValueError) as error:
            raise CaptureError(f"camera: refuses {name} = {value}: {error}") from error
        return True

    def release(self) -> None:
        """Release the shutter, and return at once."""
        self._camera.trigger_capture()

    def picture(self, seconds: float, *, keep: bool) -> bytes | None:
        """Wait for the file of the last picture; None if it doesn't arrive within `seconds`."""
        end = time.monotonic() + seconds
        while (remaining := end - time.monotonic()) > 0:
            kind, data = self._camera.wait_for_event(max(1, round(1000 * remaining)))
            if kind == self._gp.GP_EVENT_FILE_ADDED:
                return self._download(data.folder, data.name, keep=keep)
        return None

    def _download(self, folder: str, name: str, *, keep: bool) -> bytes:
        """Return the content of a file on the camera, which is deleted unless `keep`."""
        file = self._camera.file_get(folder, name, self._gp.GP_FILE_TYPE_NORMAL)
        content = bytes(file.get_data_and_size())  # a copy, as `file` owns the memory
        if not keep:
            with suppress(self._gp.GPhoto2Error):  # already removed from internal memory
                self._camera.file_delete(folder, name)
        return content

    def close(self) -> None:
        """Close the camera, whatever its state."""
        with suppress(self._gp.GPhoto2Error):
            self._camera.exit()

    def _widget(self, name: str) -> Any:
        try:
            return self._camera.get_single_config(name)
        except self._gp.GPhoto2Error as error:
            if error.code in (self._gp.GP_ERROR_BAD_PARAMETERS, self._gp.GP_ERROR_NOT_SUPPORTED):
                return None
            raise


_TIME = re.compile(r"(\d+(?:\.\d+)?)(?:/(\d+(?:\.\d+)?))?\s*(?:s|sec|\")?", re.I)


class ShutterTime(NamedTuple):
    """An exposure time: the camera's name, such as 1/60, and the duration, such as 1/64 s."""

    name: str
    seconds: float


def shutter_times(names: Iterable[str], *, nominal: bool = False) -> list[ShutterTime]:
    """Return a camera's exposure times in ascending order, without Bulb, Auto and the like.

    Photo cameras time their shutters in halves or thirds of a stop relative to one second, and
    round the names: 1/60 lasts 1/64 s, 30 lasts 32 s. With `nominal`, durations are as named.
    """
    parsed = {name: _seconds(name) for name in names}
    times = {name: seconds for name, seconds in parsed.items() if seconds}
    if not nominal:
        stops = {name: math.log2(seconds) for name, seconds in times.items()}
        # rounded names of thirds of a stop deviate by less than 0.13 stops
        thirds = all(abs(stop - round(3 * stop) / 3) < 0.13 for stop in stops.values())
        parts = 3 if thirds else 2
        times = {name: 2.0 ** (round(parts * stop) / parts) for name, stop in stops.items()}
    return sorted((ShutterTime(*time) for time in times.items()), key=lambda time: time.seconds)


def nearest_times(exposures: Sequence[float], times: Sequence[ShutterTime]) -> list[ShutterTime]:
    """Return the camera's time nearest to each exposure, by ratio.

    InputError where the camera has no times, or a time is nearest to two exposures.
    """
    if not times:
        raise InputError(
            "the camera lists no exposure times; turn its mode dial to M (manual), and set the "
            "lens to manual focus"
        )
    selected = [
        min(times, key=lambda time: abs(math.log(time.seconds / exposure)))
        for exposure in exposures
    ]
    for first, second in pairwise(selected):
        if first.seconds >= second.seconds:
            raise InputError(
                f"sensor.exposures has two times for which the camera's nearest is {first.name}; "
                f"it has {', '.join(time.name for time in times)}"
            )
    return selected


def _seconds(name: str) -> float | None:
    match = _TIME.fullmatch(name.strip())
    if match is None:
        return None
    return float(match[1]) / float(match[2] or 1)
