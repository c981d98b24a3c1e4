"""Direct, near-range and far-range light of a coloured room, a band of which is lit.

Usage: ``python docs/uses/separation.py [SIDE [FOLDER]]``, by default 96 and results/uses. Writes
``FOLDER/separation.png``, and nothing else.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib import pyplot

import rfpipe
from rfpipe.scenes import planes_scene

side = int(sys.argv[1]) if len(sys.argv) > 1 else 96
folder = Path(sys.argv[2] if len(sys.argv) > 2 else "results/uses")
folder.mkdir(parents=True, exist_ok=True)
scene = planes_scene("coloured_room", ["white"] * 7, (side, side * 9 // 8))
rig = rfpipe.OperatorRig(scene, scene.shape, scene.shape, rfpipe.CameraModel(), seed=1)
transport = rfpipe.acquire(rig, "auto", target_error=0.005).transport

column = np.linspace(0, 1, scene.shape[1])
pattern = np.tile((column > 0.1) & (column < 0.48), (side, 1))
parts = transport.separate(pattern)
pictures = {
    "relit": (parts.direct + parts.near + parts.far, 1), "direct": (parts.direct, 1),
    "near, x 5": (parts.near, 5), "far, x 5": (parts.far, 5),
}  # fmt: skip
white = np.quantile(pictures["relit"][0], 0.995)
figure, axes = pyplot.subplots(1, 4, figsize=(12, 3.3), layout="constrained")
for axis, (title, (image, gain)) in zip(axes, pictures.items(), strict=True):
    axis.imshow(np.clip(gain * image / white, 0, 1) ** (1 / 2.2))
    axis.set(title=title, xticks=[], yticks=[])
figure.savefig(folder / "separation.png")
print(f"wrote {folder / 'separation.png'}")
