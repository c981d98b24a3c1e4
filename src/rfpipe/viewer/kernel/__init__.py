"""WebAssembly kernels of the viewer: ``kernels.wat``, compiled to ``kernels.wasm``."""
