"""Settings of devices: the name or path of a driver, and the options of that driver."""

from __future__ import annotations

from typing import Any, ClassVar

from pydantic import ConfigDict, Field, SerializeAsAny, ValidationInfo, field_validator

from rfpipe import plugins
from rfpipe.config.base import Settings, Text
from rfpipe.config.mistakes import input_errors_as_mistakes
from rfpipe.errors import InputError


class FreeOptions(Settings):
    """Options of a driver without a model of its options; they are passed on unchecked."""

    model_config = ConfigDict(extra="allow", frozen=True)


class DeviceDriver(Settings):
    """A driver and its options.

    Attributes
    ----------
    group : str
        Group of entry points in which the driver's name is looked up. The class there may have an
        attribute ``Options``, a model derived from `Settings`.
    """

    group: ClassVar[str]

    driver: Text = Field(description="Name or path of the driver.")
    options: SerializeAsAny[Settings] = Field(
        default_factory=FreeOptions, validate_default=True, description="Options of the driver."
    )

    @classmethod
    def options_model(cls, driver: str) -> type[Settings]:
        """Return the model of a driver's options; InputError if there is no such driver."""
        model: type[Settings] = getattr(plugins.find(cls.group, driver), "Options", FreeOptions)
        return model

    @field_validator("driver")
    @classmethod
    def _check_driver(cls, driver: str) -> str:
        with input_errors_as_mistakes():
            cls.options_model(driver)
        return driver

    @field_validator("options", mode="before")
    @classmethod
    def _check_options(cls, options: Any, info: ValidationInfo) -> Any:
        driver = info.data.get("driver")
        if driver is None:  # the driver itself is reported as wrong
            return FreeOptions()
        if isinstance(options, Settings) and type(options) is not FreeOptions:
            return options
        values = options.model_dump() if isinstance(options, FreeOptions) else options or {}
        return cls.options_model(driver).model_validate(values)

    def make(self, **defaults: Any) -> Any:
        """Construct the device or rig from its options.

        Parameters
        ----------
        **defaults
            Values for parameters of the constructor that the options don't set. Those for which
            the constructor has no parameter are ignored.

        Raises
        ------
        InputError
            When the driver doesn't take its options.
        """
        from inspect import signature

        cls = plugins.find(self.group, self.driver)
        options = dict(self.options)
        parameters = signature(cls).parameters
        for name, value in defaults.items():
            if name in parameters and options.get(name) is None:
                options[name] = value
        try:
            signature(cls).bind(**options)
        except TypeError as error:
            raise InputError(
                f"driver {self.driver}: {error}; its parameters are "
                f"{', '.join(parameters) or 'none'}"
            ) from None
        return cls(**options)


class ProjectorDriver(DeviceDriver):
    """Projector of a rig."""

    group: ClassVar[str] = plugins.PROJECTORS

    driver: Text = Field(
        "window",
        description="window: a full-screen window on a display; dlpc900: a projector with TI's "
        "DLPC900 controller, over USB; alp: a projector with ViALUX' ALP controller; "
        "micro_manager: a projector (SLM) of Micro-Manager's catalogue; or a driver of your own, "
        "as module:Class or file.py:Class.",
    )


class CameraDriver(DeviceDriver):
    """Camera of a rig."""

    group: ClassVar[str] = plugins.CAMERAS

    driver: Text = Field(
        "pylon",
        description="pylon: a Basler camera; aravis: a GenICam camera of any maker; gphoto2: a "
        "Canon, Nikon or Sony photo camera; webcam: a V4L2 or OpenCV camera; micro_manager: a "
        "camera of Micro-Manager's catalogue; or a driver of your own, as module:Class or "
        "file.py:Class.",
    )

    @property
    def bench(self) -> str | None:
        """Path ``module:Class`` of the driver's emulated camera for the bench; None without one."""
        path: str | None = getattr(plugins.find(self.group, self.driver), "bench", None)
        return path


class RigDriver(DeviceDriver):
    """A complete rig: projector and camera together."""

    group: ClassVar[str] = plugins.RIGS

    driver: Text = Field(
        description="A rig of your own, as module:Class or file.py:Class: a class that follows "
        "rfpipe.rigs.Rig.",
    )
