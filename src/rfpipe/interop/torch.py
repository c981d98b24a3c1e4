"""A transport as a module of PyTorch."""

from __future__ import annotations

from typing import Any

from rfpipe.installation import needing
from rfpipe.interop.products import is_white, relit
from rfpipe.transport.relightable import Relightable

with needing("torch", "a transport as a module of PyTorch"):
    import torch


class TransportModule(torch.nn.Module):  # type: ignore[misc]
    """Relight with tensors, as `Relightable.relight`, with gradients of any order.

    The module has no parameters. It computes on the CPU: tensors of other devices are copied there,
    and images are copied back to the device of the patterns. Images and gradients are float32.

    Parameters
    ----------
    transport : Relightable

    Examples
    --------
    >>> image = TransportModule(transport)(pattern)  # (*projector_shape[, channels]), or batches
    """

    def __init__(self, transport: Relightable) -> None:
        super().__init__()
        self.transport = transport

    def forward(self, patterns: torch.Tensor) -> torch.Tensor:
        """Return the images (..., *camera_shape, channels).

        `patterns` has the shape (..., *projector_shape) of white light, or an axis of channels
        besides; InputError for another one and for values that are not finite.
        """
        if is_white(self.transport, tuple(patterns.shape)):
            patterns = patterns[..., None].expand(*patterns.shape, self.transport.channels)
        return _Product.apply(patterns, self.transport)


class _Product(torch.autograd.Function):  # type: ignore[misc]
    """``T p``; its gradient is the product with the dual transport, so derivatives recur."""

    @staticmethod
    def forward(patterns: torch.Tensor, transport: Relightable) -> torch.Tensor:
        images = relit(transport, patterns.float().numpy(force=True))
        return torch.from_numpy(images).to(patterns.device)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: torch.Tensor) -> None:  # noqa: ARG004
        ctx.transport = inputs[1]

    @staticmethod
    def backward(ctx: Any, gradient: torch.Tensor) -> tuple[torch.Tensor, None]:
        return _Product.apply(gradient, ctx.transport.T), None

    @staticmethod
    def vmap(
        info: Any,  # noqa: ARG004
        in_dims: tuple[int, None],
        patterns: torch.Tensor,
        transport: Relightable,
    ) -> tuple[torch.Tensor, int]:
        return _Product.apply(patterns.movedim(in_dims[0], 0), transport), 0
