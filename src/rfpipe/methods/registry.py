"""Methods by name: rfpipe's own, other packages', and the user's."""

from __future__ import annotations

import inspect
from typing import Any

from pydantic import ValidationError

from rfpipe import plugins
from rfpipe.config.base import explained
from rfpipe.errors import InputError
from rfpipe.methods.base import Method, Options

__all__ = ["get_method", "method_names", "options_of"]


def method_names() -> tuple[str, ...]:
    """Return the names of all methods that are installed."""
    return plugins.names(plugins.METHODS)


def get_method(method: str | Method[Any] | type[Method[Any]]) -> Method[Any]:
    """Return an acquisition method.

    Parameters
    ----------
    method : str or Method or type of Method
        A name in `method_names`, a path ``module:Class`` or ``file.py:Class``, or the method
        itself.

    Raises
    ------
    InputError
        If there is no such method, or what is there is none.
    """
    if isinstance(method, Method):
        return method
    found = plugins.find(plugins.METHODS, method) if isinstance(method, str) else method
    if not (inspect.isclass(found) and issubclass(found, Method)):
        raise InputError(
            f"method {method!r} is no acquisition method; expected a class derived from "
            "rfpipe.methods.Method"
        )
    missing = [name for name in ("name", "title", "colour") if not hasattr(found, name)]
    if missing or inspect.isabstract(found):
        missing += sorted(found.__abstractmethods__)
        raise InputError(f"method {method!r} lacks {', '.join(missing)}; see rfpipe.methods.Method")
    return found()


def options_of(method: Method[Any], **options: Any) -> Options:
    """Return a method's options, defaults for those that aren't given.

    Raises
    ------
    InputError
        For each that the method doesn't have, and each out of range: says what was meant.
    """
    try:
        return method.Options.model_validate(options)
    except ValidationError as error:
        lines = explained(error)
        raise InputError("\n".join(f"{method.name}: {line}" for line in lines)) from None
