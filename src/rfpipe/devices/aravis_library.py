"""Calls of the C library Aravis (0.8) for GenICam cameras, through ctypes.

The Python binding, PyGObject, has no wheels, and building it takes a compiler and matching
headers.
"""

from __future__ import annotations

import ctypes
import ctypes.util
from ctypes import byref, c_char_p, c_double, c_int, c_int64, c_size_t, c_uint, c_uint64, c_void_p
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.devices.genicam import RefusedError, Value
from rfpipe.errors import CaptureError

_LIBRARY, _GOBJECT = "libaravis-0.8.so.0", "libgobject-2.0.so.0"

_POINTER = ctypes.POINTER
_ERROR = _POINTER(c_void_p)
_FEATURE = c_void_p, c_char_p
_SIGNATURES: dict[tuple[Any, tuple[Any, ...]], tuple[str, ...]] = {
    (None, ()): ("update_device_list",),
    (c_uint, ()): ("get_n_devices",),
    (c_char_p, (c_uint,)): (
        "get_device_id", "get_device_serial_nbr", "get_device_model",
        "get_device_vendor",
    ),
    (c_void_p, (c_char_p, _ERROR)): ("open_device",),
    (c_void_p, _FEATURE): ("device_get_feature",),
    (c_int, (*_FEATURE, _ERROR)): (
        "device_is_feature_available", "device_get_boolean_feature_value",
    ),
    (None, (*_FEATURE, _ERROR)): ("device_execute_command",),
    (None, (*_FEATURE, c_int, _ERROR)): ("device_set_boolean_feature_value",),
    (None, (*_FEATURE, c_char_p, _ERROR)): ("device_set_string_feature_value",),
    (c_char_p, (*_FEATURE, _ERROR)): ("device_get_string_feature_value",),
    (c_void_p, (*_FEATURE, _POINTER(c_uint), _ERROR)): (
        "device_dup_available_enumeration_feature_values_as_strings",
    ),
    (c_void_p, (c_void_p, c_void_p, c_void_p, _ERROR)): ("device_create_stream",),
    (c_int, (c_void_p, _ERROR)): ("gc_feature_node_is_locked",),
    (c_size_t, ()): tuple(
        f"gc_{kind}_get_type" for kind in ("float", "boolean", "string", "enumeration")
    ),
    (None, (c_void_p, c_void_p)): ("stream_push_buffer",),
    (c_void_p, (c_void_p, c_uint64)): ("stream_timeout_pop_buffer",),
    (c_void_p, (c_size_t,)): ("buffer_new_allocate",),
    (c_void_p, (c_void_p, _POINTER(c_size_t))): ("buffer_get_data",),
    (c_int, (c_void_p,)): (
        "gc_feature_node_get_actual_access_mode", "buffer_get_status", "buffer_get_image_width",
        "buffer_get_image_height",
    ),
}  # fmt: skip
"""Functions by the types of their result and arguments; names without ``arv_``."""

for _kind, _value in (("integer", c_int64), ("float", c_double)):
    _bounds = *_FEATURE, _POINTER(_value), _POINTER(_value), _ERROR
    _SIGNATURES |= {
        (None, (*_FEATURE, _value, _ERROR)): (f"device_set_{_kind}_feature_value",),
        (_value, (*_FEATURE, _ERROR)): (f"device_get_{_kind}_feature_value",),
        (None, _bounds): (f"device_get_{_kind}_feature_bounds",),
    }


class AravisError(Exception):
    """An error that Aravis reports."""


class _GError(ctypes.Structure):
    _fields_ = (("domain", ctypes.c_uint32), ("code", c_int), ("message", c_char_p))


@cache
def load_aravis() -> tuple[ctypes.CDLL, ctypes.CDLL]:
    """Return the libraries Aravis and GObject, or raise CaptureError."""
    try:
        aravis = ctypes.CDLL(_LIBRARY)
        gobject = ctypes.CDLL(_GOBJECT)
        for (result, arguments), names in _SIGNATURES.items():
            for name in names:
                function = getattr(aravis, f"arv_{name}")
                function.restype, function.argtypes = result, arguments
    except (OSError, AttributeError) as error:
        raise CaptureError(
            f"Aravis can't be loaded: {error}. Install its library, version 0.8.20 or newer; on "
            "Debian: apt-get install libaravis-0.8-0"
        ) from error
    for freeing in (gobject.g_object_unref, gobject.g_error_free, gobject.g_free):
        freeing.argtypes, freeing.restype = (c_void_p,), None
    gobject.g_type_check_instance_is_a.argtypes = (c_void_p, c_size_t)
    gobject.g_type_check_instance_is_a.restype = c_int
    return aravis, gobject


def call(name: str, *arguments: Any) -> Any:
    """Call a function that reports no errors."""
    return getattr(load_aravis()[0], name)(*arguments)


def checked_call(name: str, *arguments: Any) -> Any:
    """Call a function whose last argument is a GError; raise it as AravisError."""
    aravis, gobject = load_aravis()
    error = c_void_p()
    result = getattr(aravis, name)(*arguments, byref(error))
    if error.value:
        message = ctypes.cast(error, ctypes.POINTER(_GError)).contents.message or b"unknown error"
        gobject.g_error_free(error)
        raise AravisError(message.decode(errors="replace").strip().rstrip("."))
    return result


def release(address: int | None) -> None:
    """Release a GObject by its address; nothing for None."""
    if address:
        load_aravis()[1].g_object_unref(address)


def list_cameras() -> list[tuple[bytes, str, str]]:
    """Return id, serial number and model of each connected camera."""
    call("arv_update_device_list")
    return [
        (
            call("arv_get_device_id", index),
            _text(call("arv_get_device_serial_nbr", index)),
            " ".join(_text(call(f"arv_get_device_{name}", index)) for name in ("vendor", "model")),
        )
        for index in range(call("arv_get_n_devices"))
    ]


def counts_of(buffer: int, bits: int, payload: int) -> NDArray[np.uint16]:
    """Return a copy of the frame (H, W) in an ArvBuffer, given its address.

    Counts of more than 8 bits are stored in 16 bits. AravisError where the frame has more than
    `payload` bytes.
    """
    height, width = (call(f"arv_buffer_get_image_{name}", buffer) for name in ("height", "width"))
    dtype = np.dtype(np.uint8 if bits == 8 else "<u2")
    size = height * width * dtype.itemsize
    if size > payload:
        raise AravisError(f"a frame of {height} x {width} pixels exceeds the region")
    data = call("arv_buffer_get_data", buffer, None)
    flat = np.frombuffer(ctypes.string_at(data, size), dtype)
    return flat.reshape(height, width).astype(np.uint16)


@dataclass(frozen=True)
class AravisNodes:
    """Settings of an open ArvDevice, given its address; implements `NodeMap`."""

    device: int

    def number(self, name: str) -> float | None:
        kind = self._kind(name)
        if kind not in ("float", "integer"):
            return None
        try:
            result = checked_call(
                f"arv_device_get_{kind}_feature_value", self.device, name.encode()
            )
        except AravisError:
            return None
        return float(result)

    def is_writable(self, name: str) -> bool:
        node = call("arv_device_get_feature", self.device, name.encode())
        if not node or not checked_call(
            "arv_device_is_feature_available", self.device, name.encode()
        ):
            return False
        mode = call("arv_gc_feature_node_get_actual_access_mode", node)
        is_writable = mode in (1, 2)  # WO and RW
        return is_writable and not checked_call("arv_gc_feature_node_is_locked", node)

    def write(self, name: str, value: Value) -> Value:
        kind = self._kind(name)
        try:
            if kind is None:
                raise AravisError("the camera has no such setting")
            if kind in ("float", "integer"):  # Aravis doesn't check bounds
                least, largest = self.bounds(name)
                if not least <= float(value) <= largest:
                    raise AravisError("out of range")
            plain = value.encode() if isinstance(value, str) else value
            checked_call(f"arv_device_set_{kind}_feature_value", self.device, name.encode(), plain)
            actual = checked_call(
                f"arv_device_get_{kind}_feature_value", self.device, name.encode()
            )
        except (AravisError, ctypes.ArgumentError) as error:
            raise RefusedError(str(error)) from error
        if kind == "string":
            return _text(actual)
        return bool(actual) if kind == "boolean" else actual

    def execute(self, name: str) -> None:
        checked_call("arv_device_execute_command", self.device, name.encode())

    def bounds(self, name: str) -> tuple[float, float]:
        kind = self._kind(name)
        if kind not in ("float", "integer"):
            raise RefusedError(f"the camera has no number {name}")
        number = c_double if kind == "float" else c_int64
        least, largest = number(), number()
        checked_call(
            f"arv_device_get_{kind}_feature_bounds",
            self.device, name.encode(), byref(least), byref(largest),
        )  # fmt: skip
        return least.value, largest.value

    def choices(self, name: str) -> tuple[str, ...]:
        count = c_uint()
        names = checked_call(
            "arv_device_dup_available_enumeration_feature_values_as_strings",
            self.device, name.encode(), byref(count),
        )  # fmt: skip
        if not names:
            return ()
        array = ctypes.cast(names, ctypes.POINTER(c_char_p))
        values = tuple(_text(array[index]) for index in range(count.value))
        load_aravis()[1].g_free(names)
        return values

    def _kind(self, name: str) -> str | None:
        """Return the kind of a setting, as in function names; None if it doesn't exist."""
        node = call("arv_device_get_feature", self.device, name.encode())
        if not node:
            return None
        is_a = load_aravis()[1].g_type_check_instance_is_a
        # an enumeration also has the type of integers
        for kind, type_name in (
            ("string", "enumeration"), ("boolean", "boolean"), ("float", "float"),
            ("string", "string"),
        ):  # fmt: skip
            if is_a(node, call(f"arv_gc_{type_name}_get_type")):
                return kind
        return "integer"


def _text(value: bytes | None) -> str:
    return (value or b"").decode(errors="replace")
