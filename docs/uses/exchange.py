"""A transport as lights in an EXR file, and as a paper's photographs; both fitted again.

Usage: ``python docs/uses/exchange.py [SIDE [FOLDER]]``, by default 24 and results/uses. Writes
``FOLDER/exchange.png``, and nothing else.
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from matplotlib import pyplot

import rfpipe
from rfpipe.export import write_lights, write_photographs
from rfpipe.fitting import fit_transport, read_series
from rfpipe.scenes import planes_scene

side = int(sys.argv[1]) if len(sys.argv) > 1 else 24
folder = Path(sys.argv[2] if len(sys.argv) > 2 else "results/uses")
folder.mkdir(parents=True, exist_ok=True)
scene = planes_scene("coloured_room", ["white"] * 7, (side, side * 9 // 8))
rig = rfpipe.OperatorRig(scene, scene.shape, scene.shape, rfpipe.CameraModel(), seed=1)
transport = rfpipe.acquire(rig, "auto", target_error=0.005).transport
rays = transport.shape[2]

temporary = TemporaryDirectory()
files = Path(temporary.name)
write_lights(transport, files / "lights.exr")
write_photographs(transport, files / "setup", 5 * rays // 4, 10)
of_lights = fit_transport(read_series(files / "lights.exr", lights=scene.shape))
of_setup = fit_transport(read_series(files / "setup"))

pattern = np.zeros(scene.shape)
pattern[side // 3 : side * 2 // 3, side // 6 : side // 2] = 1
pictures = {
    "the transport": transport,
    f"from {rays} lights": of_lights.transport,
    f"from {5 * rays // 4} photographs, 8 bits": of_setup.transport,
}
white = np.quantile(transport.relight(pattern), 0.99)
figure, axes = pyplot.subplots(1, 3, figsize=(10, 3.3), layout="constrained")
for axis, (title, each) in zip(axes, pictures.items(), strict=True):
    axis.imshow(np.clip(each.relight(pattern) / white, 0, 1) ** (1 / 2.2))
    axis.set(title=title, xticks=[], yticks=[])
figure.suptitle(f"photographs that no fit saw are {of_setup.error:.2%} off", fontsize="medium")
figure.savefig(folder / "exchange.png")
print(f"wrote {folder / 'exchange.png'}")
temporary.cleanup()
