"""Direct, near-range and far-range light of a coloured room, a band of which is lit."""

import sys

import numpy as np
from matplotlib import pyplot

import rfpipe
from rfpipe.scenes import planes_scene

side = int(sys.argv[1]) if len(sys.argv) > 1 else 96
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
figure.savefig("separation.png")
