"""A transport as a function of Dr.Jit, and so of Mitsuba 3."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rfpipe.installation import needing
from rfpipe.interop.products import is_white, relit
from rfpipe.transport.relightable import Relightable

with needing("mitsuba", "a transport as a function of Dr.Jit"):
    import drjit as dr


def relight_function(transport: Relightable) -> Callable[[Any], Any]:
    """Return a function that relights with tensors of Dr.Jit, as `Relightable.relight`.

    The function maps patterns (..., *projector_shape[, channels]) to images (..., *camera_shape,
    channels), float32, and raises InputError for another shape. A pattern is a ``TensorXf`` of a
    differentiable backend, such as ``mitsuba.TensorXf`` of the variants ``llvm_ad_rgb`` and
    ``cuda_ad_rgb``; its image has the same type. Forward and backward derivatives are defined. Both
    the function and its derivatives evaluate their argument, and compute on the CPU.
    """

    class Product(dr.CustomOp):
        """``T p``, with the dual transport for the gradient."""

        def eval(self, patterns: Any) -> Any:
            return type(patterns)(relit(transport, patterns.numpy()))

        def forward(self) -> None:
            direction: Any = self.grad_in("patterns")
            self.set_grad_out(self.eval(direction))

        def backward(self) -> None:
            gradient: Any = self.grad_out()
            self.set_grad_in("patterns", type(gradient)(relit(transport.T, gradient.numpy())))

        def name(self) -> str:
            return "relight"

    def relight(patterns: Any) -> Any:
        if is_white(transport, patterns.shape):
            patterns = patterns[..., None] * dr.ones(type(patterns), (transport.channels,))
        return dr.custom(Product, patterns)

    return relight
