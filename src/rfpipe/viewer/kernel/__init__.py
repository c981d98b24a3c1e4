"""The viewer's WebAssembly kernels: ``kernels.wat``, and ``kernels.wasm`` made from it."""
