"""A photo camera behind libgphoto2: its settings, exposure times and pictures."""

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


def connected() -> list[tuple[str, str]]:
    """Return model and port of each camera that answers."""
    cameras = load_gphoto2().Camera.autodetect()
    return [(cameras.get_name(index), cameras.get_value(index)) for index in range(cameras.count())]


class Photo:
    """An open camera, by model and port as `connected` names them.

    gphoto2.GPhoto2Error where it can't be opened, and by methods where the camera fails.
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
        """Return a setting, None where the camera has none of this name."""
        widget = self._widget(name)
        return None if widget is None else widget.get_value()

    def choices(self, name: str) -> list[str]:
        """Return the values of a setting, none where the camera has no such one or takes any."""
        widget = self._widget(name)
        if widget is None or widget.get_type() not in (
            self._gp.GP_WIDGET_RADIO, self._gp.GP_WIDGET_MENU,
        ):  # fmt: skip
            return []
        return [widget.get_choice(index) for index in range(widget.count_choices())]

    def set(self, name: str, value: Setting) -> bool:
        """Make a setting; False where the camera has none of this name, or it is fixed.

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
        """Press the shutter and don't wait."""
        self._camera.trigger_capture()

    def picture(self, seconds: float, *, keep: bool) -> bytes | None:
        """Return the file of the picture just taken, None where none comes in so many seconds."""
        gp, end = self._gp, time.monotonic() + seconds
        while (rest := end - time.monotonic()) > 0:
            kind, data = self._camera.wait_for_event(max(1, round(1000 * rest)))
            if kind == gp.GP_EVENT_FILE_ADDED:
                file = self._camera.file_get(data.folder, data.name, gp.GP_FILE_TYPE_NORMAL)
                content = bytes(file.get_data_and_size())  # a copy: the memory is the file's
                if not keep:
                    with suppress(gp.GPhoto2Error):  # gone already, from a camera's own memory
                        self._camera.file_delete(data.folder, data.name)
                return content
        return None

    def close(self) -> None:
        """Let go of the camera, whatever state it is in."""
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
    """An exposure time: the camera's name of it, such as 1/60, and its length, such as 1/64 s."""

    name: str
    seconds: float


def shutter_times(names: Iterable[str], *, nominal: bool = False) -> list[ShutterTime]:
    """Return a camera's exposure times, ascending; Bulb, Auto and the like are left out.

    Photo cameras time their shutters in halves or thirds of a stop from one second, whole powers
    of two among them, and round only the names: 1/60 is 1/64 s, 30 is 32 s. `nominal` takes the
    names at their word.
    """
    named = {name: _seconds(name) for name in names}
    times = {name: seconds for name, seconds in named.items() if seconds}
    if not nominal:
        stops = {name: math.log2(seconds) for name, seconds in times.items()}
        # as named, a time of a camera set to thirds misses one by less than 0.13 stops
        thirds = all(abs(stop - round(3 * stop) / 3) < 0.13 for stop in stops.values())
        parts = 3 if thirds else 2
        times = {name: 2.0 ** (round(parts * stop) / parts) for name, stop in stops.items()}
    return sorted((ShutterTime(*time) for time in times.items()), key=lambda time: time.seconds)


def nearest_times(exposures: Sequence[float], times: Sequence[ShutterTime]) -> list[ShutterTime]:
    """Return the camera's time nearest to each exposure, by their ratio.

    InputError where the camera has none, or one is nearest to two exposures.
    """
    if not times:
        raise InputError(
            "the camera lists no exposure times; turn its mode dial to M (manual), and set the "
            "lens to manual focus"
        )
    chosen = [
        min(times, key=lambda time: abs(math.log(time.seconds / exposure)))
        for exposure in exposures
    ]
    for first, second in pairwise(chosen):
        if first.seconds >= second.seconds:
            raise InputError(
                f"sensor.exposures has two times for which the camera's nearest is {first.name}; "
                f"it has {', '.join(time.name for time in times)}"
            )
    return chosen


def _seconds(name: str) -> float | None:
    match = _TIME.fullmatch(name.strip())
    if match is None:
        return None
    return float(match[1]) / float(match[2] or 1)
