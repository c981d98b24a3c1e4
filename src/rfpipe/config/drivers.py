"""Devices in settings: a driver by its name or path, and options of its own."""

from __future__ import annotations

from typing import Any, ClassVar

from pydantic import ConfigDict, Field, SerializeAsAny, ValidationInfo, field_validator

from rfpipe import plugins
from rfpipe.config.base import Settings, Text, known, setting
from rfpipe.errors import InputError


class FreeOptions(Settings):
    """Options of a driver that has no model of them: they are passed on as they are."""

    model_config = ConfigDict(extra="allow", frozen=True)


class DeviceDriver(Settings):
    """A driver, and its options.

    Attributes
    ----------
    group : str
        The group of entry points among which a driver's name is looked up. What it stands for may
        have an attribute ``Options``, a model derived from `Settings`.
    """

    group: ClassVar[str]

    driver: Text = Field(description="The driver.")
    options: SerializeAsAny[Settings] = Field(
        default_factory=FreeOptions, validate_default=True, description="The driver's options."
    )

    @classmethod
    def options_model(cls, driver: str) -> type[Settings]:
        """Return the model of a driver's options; raise InputError if there is no such driver."""
        model: type[Settings] = getattr(plugins.find(cls.group, driver), "Options", FreeOptions)
        return model

    @field_validator("driver")
    @classmethod
    def _is_known(cls, driver: str) -> str:
        known(lambda: cls.options_model(driver))
        return driver

    @field_validator("options", mode="before")
    @classmethod
    def _are_of_the_driver(cls, options: Any, info: ValidationInfo) -> Any:
        driver = info.data.get("driver")
        if driver is None:  # it is wrong itself, and nothing is known of its options
            return FreeOptions()
        if isinstance(options, Settings) and type(options) is not FreeOptions:
            return options
        values = options.model_dump() if isinstance(options, FreeOptions) else options or {}
        return cls.options_model(driver).model_validate(values)

    def make(self, **known: Any) -> Any:
        """Return the device or rig.

        It is made from its options by name. Of what else is known of it, it gets what its
        constructor has a parameter for and its options don't say.

        Raises
        ------
        InputError
            When the driver doesn't take its options.
        """
        from inspect import signature

        cls = plugins.find(self.group, self.driver)
        options = dict(self.options)
        parameters = signature(cls).parameters
        for name, value in known.items():
            if name in parameters and options.get(name) is None:
                options[name] = value
        try:
            signature(cls).bind(**options)
        except TypeError as error:
            raise InputError(
                f"driver {self.driver}: {error}; it is made with "
                f"{', '.join(parameters) or 'nothing'}"
            ) from None
        return cls(**options)


class ProjectorDriver(DeviceDriver):
    """A projector."""

    group: ClassVar[str] = plugins.PROJECTORS

    driver: Text = setting(
        "window",
        "window: a full-screen window on a display; dlpc900: a projector with TI's DLPC900 "
        "controller, over USB; or a driver of your own, as module:Class or file.py:Class.",
    )


class CameraDriver(DeviceDriver):
    """A camera."""

    group: ClassVar[str] = plugins.CAMERAS

    driver: Text = setting(
        "pylon",
        "pylon: a Basler camera; aravis: a GenICam camera of any maker; gphoto2: a Canon, Nikon or "
        "Sony photo camera; webcam: a V4L2 or OpenCV camera; or a driver of your own, as "
        "module:Class or file.py:Class.",
    )

    @property
    def bench(self) -> str | None:
        """Where the driver's camera of the bench in software is, module:Class, if it has one."""
        path: str | None = getattr(plugins.find(self.group, self.driver), "bench", None)
        return path


class RigDriver(DeviceDriver):
    """A rig as a whole."""

    group: ClassVar[str] = plugins.RIGS

    driver: Text = Field(
        description="A rig of your own, as module:Class or file.py:Class: a class that follows "
        "rfpipe.rigs.Rig.",
    )
