"""Transports as functions of PyTorch, JAX and Dr.Jit: equal to `relight`, and differentiable."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.results.transports import transport_of

from rfpipe.errors import InputError
from rfpipe.transport.base import Transport

USES = Path(__file__).parents[2] / "docs" / "uses.md"
KINDS = (
    "brute_force", "symmetric", "near_far", "dual of two domains", "light field", "one channel",
)  # fmt: skip


def function_of_torch(transport: Transport) -> tuple[Any, Any]:
    """Return the module, and a function for the gradient of |T p - c|^2."""
    import torch

    from rfpipe.interop.torch import TransportModule

    relight = TransportModule(transport)

    def gradient(pattern: NDArray[Any], target: NDArray[Any]) -> NDArray[Any]:
        variable = torch.tensor(pattern, requires_grad=True)
        (relight(variable) - torch.from_numpy(target)).square().sum().backward()
        return variable.grad.numpy()

    return lambda pattern: relight(torch.from_numpy(pattern)).numpy(), gradient


def function_of_jax(transport: Transport) -> tuple[Any, Any]:
    import jax

    from rfpipe.interop.jax import relight_function

    relight = relight_function(transport)
    return relight, jax.grad(lambda pattern, target: ((relight(pattern) - target) ** 2).sum())


def function_of_drjit(transport: Transport) -> tuple[Any, Any]:
    from rfpipe.mitsuba.variant import load_mitsuba

    mi = load_mitsuba()
    import drjit as dr

    from rfpipe.interop.drjit import relight_function

    relight = relight_function(transport)

    def gradient(pattern: NDArray[Any], target: NDArray[Any]) -> NDArray[Any]:
        variable = mi.TensorXf(pattern)
        dr.enable_grad(variable)
        dr.backward(dr.sum(dr.square(relight(variable) - mi.TensorXf(target))))
        return dr.grad(variable).numpy()

    return lambda pattern: relight(mi.TensorXf(pattern)).numpy(), gradient


FRAMEWORKS = [
    pytest.param(function_of_torch, marks=pytest.mark.needs("torch"), id="torch"),
    pytest.param(function_of_jax, id="jax"),
    pytest.param(function_of_drjit, marks=pytest.mark.needs("llvm"), id="drjit"),
]


def patterns_for(transport: Transport, white: bool, count: int) -> NDArray[np.float32]:
    shape = transport.projector_shape if white else (*transport.projector_shape, transport.channels)
    return np.random.default_rng(1).random((count, *shape), dtype=np.float32)


def target_for(transport: Transport) -> NDArray[np.float32]:
    shape = (*transport.camera_shape, transport.channels)
    return np.random.default_rng(2).random(shape, dtype=np.float32)


@pytest.mark.parametrize("white", [True, False], ids=["white", "colour"])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("framework", FRAMEWORKS)
def test_a_function_relights_and_its_gradient_is_the_dual(framework, kind: str, white) -> None:
    transport = transport_of(kind)
    relight, gradient = framework(transport)
    batch, target = patterns_for(transport, white, 2), target_for(transport)
    images = transport.relight_batch(batch)
    np.testing.assert_allclose(relight(batch), images, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(relight(batch[0]), images[0], rtol=1e-5, atol=1e-6)
    dual = 2 * transport.T.relight(images[0] - target)
    expected = dual.sum(axis=-1) if white else dual
    tolerance = 1e-5 * np.abs(expected).max()
    np.testing.assert_allclose(gradient(batch[0], target), expected, atol=tolerance)


@pytest.mark.parametrize("framework", FRAMEWORKS)
def test_a_pattern_of_another_shape_is_refused(framework) -> None:
    relight, _ = framework(transport_of("dual of two domains"))
    with pytest.raises(InputError, match=r"\(11, 9\); expected \(9, 11\) or \(9, 11, 3\)"):
        relight(np.ones((11, 9), np.float32))


@pytest.mark.needs("torch")
@pytest.mark.filterwarnings("ignore:Input .* double precision")  # relighting is in float32
def test_torch_agrees_with_finite_differences_in_first_and_second_order() -> None:
    import torch

    from rfpipe.interop.torch import TransportModule

    transport = transport_of("dual of two domains")
    module = TransportModule(transport)
    pattern = torch.tensor(patterns_for(transport, True, 1)[0], requires_grad=True)

    def quartic(pattern: torch.Tensor) -> torch.Tensor:
        return module(pattern**2).square().mean()

    assert torch.autograd.gradcheck(module, pattern, eps=1, atol=1e-3, fast_mode=True)
    assert torch.autograd.gradgradcheck(
        quartic, pattern, eps=1e-2, atol=1e-3, rtol=1e-2, fast_mode=True
    )
    gradients = torch.func.vmap(torch.func.grad(quartic))(pattern.detach()[None])
    torch.testing.assert_close(gradients[0], torch.autograd.grad(quartic(pattern), pattern)[0])


def test_jax_compiles_and_batches_gradients_of_any_order() -> None:
    import jax

    from rfpipe.interop.jax import relight_function

    transport = transport_of("dual of two domains")
    relight = relight_function(transport)
    batch = patterns_for(transport, True, 3)
    images = jax.jit(jax.vmap(relight))(batch)
    np.testing.assert_allclose(images, transport.relight_batch(batch), rtol=1e-5)

    def energy(pattern: jax.Array) -> jax.Array:
        return (relight(pattern) ** 2).sum()

    duals = transport.T.relight_batch(transport.relight_batch(batch))
    gradients = jax.jit(jax.vmap(jax.grad(energy)))(batch)
    np.testing.assert_allclose(gradients, 2 * duals.sum(axis=-1), rtol=1e-4)
    matrix = transport.toarray()
    hessian = jax.jit(jax.jacrev(jax.grad(energy)))(batch[0])
    expected = 2 * np.einsum("cmi,cmj->ij", matrix, matrix)
    np.testing.assert_allclose(hessian.reshape(expected.shape), expected, rtol=1e-4, atol=1e-6)


@pytest.mark.needs("llvm")
def test_drjit_propagates_derivatives_forward() -> None:
    from rfpipe.mitsuba.variant import load_mitsuba

    mi = load_mitsuba()
    import drjit as dr

    from rfpipe.interop.drjit import relight_function

    transport = transport_of("dual of two domains")
    pattern, direction = patterns_for(transport, False, 2)
    variable = mi.TensorXf(pattern)
    dr.enable_grad(variable)
    dr.set_grad(variable, direction)
    derivative = dr.forward_to(relight_function(transport)(variable))
    np.testing.assert_allclose(derivative.numpy(), transport.relight(direction), rtol=1e-5)


@pytest.mark.needs("torch")
def test_the_example_finds_the_pattern_of_a_picture() -> None:
    text = USES.read_text("utf-8")
    block = re.search(r"^```python\n(import torch\n.*?)^```", text, re.M | re.S)
    transport = transport_of("brute_force")
    lit = 0.2 + 0.6 * patterns_for(transport, False, 1)[0]
    names = {"transport": transport, "picture": transport.relight(lit)}
    exec(compile(block[1], USES, "exec"), names)
    error = transport.relight(names["pattern"].numpy()) - names["picture"]
    assert np.linalg.norm(error) < 0.02 * np.linalg.norm(names["picture"])


@pytest.mark.parametrize("framework", ["torch", "jax", "drjit"])
def test_a_missing_framework_is_an_error_that_names_the_extra(framework: str) -> None:
    code = f"import sys; sys.modules[{framework!r}] = None; import rfpipe.interop.{framework}"
    done = subprocess.run(
        [sys.executable, "-c", code], check=False, capture_output=True, text=True, timeout=60
    )
    extra = "mitsuba" if framework == "drjit" else framework
    assert f"needs the extra {extra}" in done.stderr
