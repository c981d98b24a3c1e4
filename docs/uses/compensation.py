"""A checkerboard on a textured crease: projected as it is, and by the pattern that makes it.

Usage: ``python docs/uses/compensation.py [SIDE [FOLDER]]``, by default 64 and results/uses. Writes
``FOLDER/compensation.png``, and nothing else.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib import pyplot

import rfpipe
from rfpipe.scenes import reference_scene

side = int(sys.argv[1]) if len(sys.argv) > 1 else 64
folder = Path(sys.argv[2] if len(sys.argv) > 2 else "results/uses")
folder.mkdir(parents=True, exist_ok=True)
scene = reference_scene("IV", (side, side))
rig = rfpipe.OperatorRig(scene, scene.shape, scene.shape, rfpipe.CameraModel(), seed=1)
transport = rfpipe.acquire(rig, "auto", target_error=0.005).transport
floodlit = transport.relight(np.ones(scene.shape))

row, column = np.indices(scene.shape) * 8 // side
wished = 0.2 * np.quantile(floodlit, 0.1) * (2 + (row + column) % 2)
found = transport.pattern_for(wished)
# as if all light were direct, as many programs have it
plain = np.clip(wished[..., None] / np.maximum(floodlit, 1e-6), 0, 1).astype(np.float32)


def seen(pattern: np.ndarray) -> np.ndarray:
    """Return what the scene, not the transport, shows under a pattern."""
    planes = np.moveaxis(pattern.reshape(-1, 3), 1, 0)
    images = scene.apply(planes)  # of white light, each
    return np.stack([images[c, :, c] for c in range(3)], axis=-1).reshape(*scene.shape, 3)


goal = np.repeat(wished[..., None], 3, axis=-1)
pictures = {"wished": goal, "over the floodlit image": seen(plain),
            "by the transport": seen(found.pattern)}  # fmt: skip
figure, axes = pyplot.subplots(1, 3, figsize=(9, 3.3), layout="constrained")
for axis, (title, image) in zip(axes, pictures.items(), strict=True):
    off = np.linalg.norm(image - goal) / np.linalg.norm(goal)
    axis.imshow(np.clip(image / (2 * wished.max()), 0, 1) ** (1 / 2.2))
    axis.set(title=f"{title}: {off:.1%} off" if off else title, xticks=[], yticks=[])
figure.savefig(folder / "compensation.png")
print(f"wrote {folder / 'compensation.png'}")
