"""A photo camera behind libgphoto2: its settings by name, and the picture that it takes."""

from __future__ import annotations

import os
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from rfpipe.errors import CaptureError, installing

__all__ = ["Photo", "connected", "load_gphoto2", "use_virtual"]

Setting = bool | int | float | str


def load_gphoto2() -> Any:
    """Return the module ``gphoto2``, or raise CaptureError."""
    try:
        import gphoto2
    except ImportError as error:
        raise CaptureError(
            f"gphoto2 can't be loaded: {error}. To install it, {installing('gphoto2')}"
        ) from error
    return gphoto2


def use_virtual(folder: Path) -> None:
    """Have libgphoto2 see its virtual camera alone, which takes the first picture in a folder.

    Raises
    ------
    CaptureError
        When the installed gphoto2 has none, or the folder has no picture for it.
    """
    ports = Path(load_gphoto2().__file__).parent / "libgphoto2" / "vusb"
    if not ports.is_dir():
        raise CaptureError(
            "the installed gphoto2 comes without libgphoto2's virtual camera; its wheels have it: "
            "pip install --force-reinstall --only-binary gphoto2 gphoto2"
        )
    if not any(path.suffix.lower() == ".jpg" for path in folder.rglob("*")):
        raise CaptureError(
            f"camera.virtual is {folder}, which has no picture to take; put a raw file in it whose "
            "name ends in .jpg, as the virtual camera asks for"
        )
    os.environ["IOLIBS"], os.environ["VCAMERADIR"] = str(ports), str(folder)


def connected() -> list[tuple[str, str]]:
    """Return model and port of each camera that answers."""
    found = load_gphoto2().Camera.autodetect()
    return [(found.get_name(index), found.get_value(index)) for index in range(found.count())]


class Photo:
    """An open camera.

    Parameters
    ----------
    model, port : str
        As `connected` names them.

    Raises
    ------
    gphoto2.GPhoto2Error
        When it can't be opened; methods raise it, too, when the camera fails.
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
        """Return what a setting may be, nothing where the camera has none or takes any value."""
        widget = self._widget(name)
        if widget is None or widget.get_type() not in (
            self._gp.GP_WIDGET_RADIO, self._gp.GP_WIDGET_MENU,
        ):  # fmt: skip
            return []
        return [widget.get_choice(index) for index in range(widget.count_choices())]

    def set(self, name: str, value: Setting) -> bool:
        """Make a setting; False where the camera has none of this name, or it is fixed.

        Raises
        ------
        CaptureError
            When the camera refuses the value.
        """
        widget = self._widget(name)
        if widget is None or widget.get_readonly():
            return False
        known = self.choices(name)
        if known and str(value) not in known:
            raise CaptureError(f"camera: {name} can't be {value}; it is one of {', '.join(known)}")
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
        while (left := end - time.monotonic()) > 0:
            kind, data = self._camera.wait_for_event(max(1, round(1000 * left)))
            if kind == gp.GP_EVENT_FILE_ADDED:
                file = self._camera.file_get(data.folder, data.name, gp.GP_FILE_TYPE_NORMAL)
                found = bytes(file.get_data_and_size())  # a copy: the memory is the file's
                if not keep:
                    with suppress(gp.GPhoto2Error):  # gone already, from a camera's own memory
                        self._camera.file_delete(data.folder, data.name)
                return found
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
