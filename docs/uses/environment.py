"""A sphere under 60 lights, one at a time, relit by a panorama that turns around it.

Usage: ``python docs/uses/environment.py [SIDE [FOLDER]]``, by default 128 and results/uses. Writes
``FOLDER/environment.png``, and nothing else.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib import pyplot

import rfpipe

side = int(sys.argv[1]) if len(sys.argv) > 1 else 128
folder = Path(sys.argv[2] if len(sys.argv) > 2 else "results/uses")
folder.mkdir(parents=True, exist_ok=True)
turn = np.arange(60) * np.pi * (3 - 5**0.5)  # evenly over the sphere
height = 1 - 2 * (np.arange(60) + 0.5) / 60
ring = np.sqrt(1 - height**2)
lights = np.stack([ring * np.sin(turn), height, ring * np.cos(turn)], axis=1)

# pictures of one light at a time, as a light stage takes them: a matt sphere with a highlight
y, x = (1.1 - 2.2 * (each + 0.5) / side for each in np.indices((side, side)))
x, inside = -x, x**2 + y**2 < 1
normals = np.stack([x, y, np.sqrt(np.maximum(1 - x**2 - y**2, 0))], axis=-1)
halfway = lights + np.array([0, 0, 1])
halfway /= np.linalg.norm(halfway, axis=1, keepdims=True)
facing = np.maximum(normals @ lights.T, 0)
pictures = inside[..., None] * facing * (0.2 + 2 * np.maximum(normals @ halfway.T, 0) ** 60)
rig = rfpipe.OperatorRig(pictures.reshape(-1, 60), (side, side), (1, 60))
transport = rfpipe.acquire(rig, "brute_force", progress=False).transport
transport.lights = lights  # as `rfpipe fit` sets them from a folder of pictures

up, right = np.meshgrid(np.linspace(90, -90, 64), np.linspace(-180, 180, 128), indexing="ij")
sky = np.where(up[..., None] > 0, [0.3, 0.45, 0.8], [0.25, 0.2, 0.15])
sun = ((up - 35) ** 2 + right**2 < 150)[..., None] * np.array([60, 50, 35])
panorama = sky + sun
views = [transport.relight_environment(panorama, turned=angle) for angle in (0, 60, 120)]
figure, axes = pyplot.subplots(1, 4, figsize=(12, 3.2), layout="constrained")
images = {"panorama": panorama, "as it is": views[0], "turned by 60": views[1], "by 120": views[2]}
for axis, (title, image) in zip(axes, images.items(), strict=True):
    axis.imshow(np.clip(image / np.quantile(image, 0.97), 0, 1) ** (1 / 2.2))
    axis.set(title=title, xticks=[], yticks=[])
figure.savefig(folder / "environment.png")
print(f"wrote {folder / 'environment.png'}")
