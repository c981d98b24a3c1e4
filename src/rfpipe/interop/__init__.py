"""Transports as differentiable functions of other frameworks, each an optional dependency.

`torch.TransportModule` is a module of PyTorch; `jax.relight_function` and `drjit.relight_function`
return functions of arrays of JAX and of Dr.Jit. Relighting is linear, ``c = T p`` per channel, so
the gradient with respect to a pattern is the dual transport applied to the gradient with respect to
the image: ``dL/dp = T^T dL/dc``. All three call `Relightable.relight_batch` of the transport and of
its dual on the CPU, in float32; gradients with respect to the transport itself are not computed.
"""
