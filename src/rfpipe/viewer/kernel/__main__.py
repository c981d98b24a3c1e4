"""Compile ``kernels.wasm`` from ``kernels.wat``: ``python -m rfpipe.viewer.kernel``."""

from pathlib import Path

import wasmtime

if __name__ == "__main__":
    source = Path(__file__).with_name("kernels.wat")
    binary = bytes(wasmtime.wat2wasm(source.read_text(encoding="utf-8")))
    source.with_suffix(".wasm").write_bytes(binary)
    print(f"{source.with_suffix('.wasm').name}: {len(binary)} bytes")
