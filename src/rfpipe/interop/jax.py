"""A transport as a function of JAX."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from rfpipe.installation import needing
from rfpipe.interop.products import image_shape, is_white, relit
from rfpipe.transport.relightable import Relightable

with needing("jax", "a transport as a function of JAX"):
    import jax
    from jax import numpy as jnp


def relight_function(transport: Relightable) -> Callable[[jax.typing.ArrayLike], jax.Array]:
    """Return a function that relights with arrays of JAX, as `Relightable.relight`.

    The function maps patterns (..., *projector_shape[, channels]) to images (..., *camera_shape,
    channels), float32, and raises InputError for another shape. It works under ``jax.jit``,
    ``jax.vmap`` and reverse-mode derivatives of any order (``jax.grad``, ``jax.vjp``,
    ``jax.jacrev``). Forward-mode derivatives (``jax.jvp``) are not defined; since the function is
    linear, they are the function itself. The product runs on the CPU, as a ``jax.pure_callback``.
    """

    def relight(patterns: jax.typing.ArrayLike) -> jax.Array:
        patterns = jnp.asarray(patterns, jnp.float32)
        if is_white(transport, patterns.shape):
            colours = (*patterns.shape, transport.channels)
            patterns = jnp.broadcast_to(patterns[..., None], colours)
        return _product(transport, patterns)

    return relight


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def _product(transport: Relightable, patterns: jax.Array) -> jax.Array:
    """Compute ``T p``; its gradient is the product with the dual transport."""
    images = jax.ShapeDtypeStruct(image_shape(transport, patterns.shape), jnp.float32)

    def product(patterns: jax.Array) -> np.ndarray[Any, Any]:
        return relit(transport, np.asarray(patterns))

    return jax.pure_callback(product, images, patterns, vmap_method="expand_dims")


def _forward(transport: Relightable, patterns: jax.Array) -> tuple[jax.Array, None]:
    return _product(transport, patterns), None


def _backward(transport: Relightable, _: None, gradient: jax.Array) -> tuple[jax.Array]:
    return (_product(transport.T, gradient),)


_product.defvjp(_forward, _backward)
