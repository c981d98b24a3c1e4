"""A projector (SLM) of Micro-Manager in software: the calls of MMCore that reach such a device."""

# ruff: noqa: N802 - the names are MMCore's

from typing import Any

import numpy as np


class SlmCore:
    """MMCore with one projector, whose adapter ``Slm`` has the device ``Slm``.

    Parameters
    ----------
    shape : (int, int)
        Height and width in pixels.
    bytes_per_pixel : int
        1 for grey, 4 for colour.
    """

    def __init__(self, shape: tuple[int, int], bytes_per_pixel: int = 1) -> None:
        self.shape, self.bytes_per_pixel = shape, bytes_per_pixel
        self.light = np.zeros(shape)
        self.properties: dict[str, str] = {"Lamp": "Off"}
        self.exposure_ms = 10.0
        self.fault: str | None = None
        self._waiting = self.light
        self._loaded: set[str] = set()

    def setDeviceAdapterSearchPaths(self, paths: list[str]) -> None:
        self.paths = paths

    def getAPIVersionInfo(self) -> str:
        return "Device API version 75"

    def loadDevice(self, label: str, library: str, name: str) -> None:
        if library != "Slm" or name != "Slm":
            raise RuntimeError(f'Failed to load device adapter "{library}"')
        self._loaded.add(label)

    def loadSystemConfiguration(self, path: str) -> None:
        self._loaded.add("Slm")

    def initializeDevice(self, label: str) -> None:
        self._check(label)

    def unloadAllDevices(self) -> None:
        self._loaded.clear()

    def getSLMDevice(self) -> str:
        return "Slm"

    def setSLMDevice(self, label: str) -> None:
        self._check(label)

    def getDevicePropertyNames(self, label: str) -> tuple[str, ...]:
        return tuple(self.properties)

    def getAllowedPropertyValues(self, label: str, name: str) -> tuple[str, ...]:
        return "Off", "On"

    def setProperty(self, label: str, name: str, value: str) -> None:
        self._check(label)
        if name not in self.properties or value not in ("Off", "On"):
            raise RuntimeError(f'Cannot set property "{name}" to "{value}"')
        self.properties[name] = value

    def getSLMHeight(self, label: str) -> int:
        return self.shape[0]

    def getSLMWidth(self, label: str) -> int:
        return self.shape[1]

    def getSLMBytesPerPixel(self, label: str) -> int:
        return self.bytes_per_pixel

    def setSLMExposure(self, label: str, exposure_ms: float) -> None:
        self.exposure_ms = exposure_ms

    def setSLMImage(self, label: str, pixels: np.ndarray[Any, Any]) -> None:
        """Hold an image until it is displayed."""
        self._check(label)
        assert pixels.dtype == np.uint8
        assert pixels.shape == self.shape + (() if self.bytes_per_pixel == 1 else (3,))
        self._waiting = pixels.reshape(*self.shape, -1).mean(axis=-1) / 255

    def displaySLMImage(self, label: str) -> None:
        self._check(label)
        self.light = self._waiting

    def waitForDevice(self, label: str) -> None:
        self._check(label)

    def _check(self, label: str) -> None:
        if self.fault is not None:
            raise RuntimeError(self.fault)
        if label not in self._loaded:
            raise RuntimeError(f'No device with label "{label}"')
