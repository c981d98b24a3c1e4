"""Photographs under the lights of a dome in a folder, relit by a panorama, and their normals.

Usage: ``python docs/uses/dome.py [SIDE [FOLDER]]``, by default 128 and results/uses. Writes
``FOLDER/dome.png``, and the photographs into ``FOLDER/dome``.
"""

import shutil
import sys
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
from matplotlib import pyplot

import rfpipe
from rfpipe.fitting import fit_transport, read_series

side = int(sys.argv[1]) if len(sys.argv) > 1 else 128
folder = Path(sys.argv[2] if len(sys.argv) > 2 else "results/uses")
folder.mkdir(parents=True, exist_ok=True)
count = 40
turn = np.arange(count) * np.pi * (3 - 5**0.5)  # evenly over the camera's half of the sphere
z = 1 - 0.95 * (np.arange(count) + 0.5) / count
ring = np.sqrt(1 - z**2)
lights = np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1)

# photographs as somebody takes them: 8 bits, with noise; a relief with ripples, matt and coloured
x, y = np.meshgrid(np.linspace(-1, 1, side), np.linspace(1, -1, side))
distance = np.hypot(x, y)
slope = -0.5 * np.sin(9 * distance) / np.maximum(distance, 0.1)
normals = np.stack([-slope * x, -slope * y, np.ones_like(x)], axis=-1)
normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
albedo = np.where(np.sin(6 * np.arctan2(y, x))[..., None] > 0, [0.8, 0.55, 0.3], [0.35, 0.5, 0.7])
facing = np.maximum(np.moveaxis(normals @ lights.T, -1, 0), 0)[..., None]
noise = 1.5 * np.random.default_rng(1).standard_normal((count, side, side, 3))
counts = np.clip(240 * albedo * facing + noise, 0, 255)
photographs = folder / "dome"
shutil.rmtree(photographs, ignore_errors=True)
photographs.mkdir()
for index, picture in enumerate(np.rint(counts).astype(np.uint8)):
    image = oiio.ImageBuf(np.ascontiguousarray(picture))
    image.specmod().attribute("oiio:ColorSpace", "lin_rec709_scene")  # linear, not sRGB
    image.write(str(photographs / f"{index + 1:02d}.png"))
np.savetxt(photographs / "lights.txt", lights, header=f"{count}", comments="")

fit = fit_transport(read_series(photographs))  # as `rfpipe fit` does
surface = fit.transport.normals()
up, right = np.meshgrid(np.linspace(90, -90, 64), np.linspace(-180, 180, 128), indexing="ij")
sky = np.where(up[..., None] > 0, [0.3, 0.45, 0.8], [0.25, 0.2, 0.15])
panorama = sky + ((up - 30) ** 2 + (right + 50) ** 2 < 150)[..., None] * np.array([60, 50, 35])
relit = fit.transport.relight_environment(panorama)
covered = rfpipe.environment_coverage(panorama, fit.transport.lights)
off = np.degrees(np.arccos(np.clip((surface.normals * normals).sum(axis=-1), -1, 1)))
images = {
    f"1 of {count} photographs": counts[count // 2] / 255,
    f"panorama, {covered:.0%} covered": panorama / np.quantile(panorama, 0.97),
    "relit by it": relit / np.quantile(relit, 0.99),
    f"normals, {np.median(off[surface.mask]):.1f}° off": surface.normals / 2 + 0.5,
}
figure, axes = pyplot.subplots(1, 4, figsize=(12, 3.2), layout="constrained")
for axis, (title, image) in zip(axes, images.items(), strict=True):
    gamma = 1 if title.startswith("normals") else 1 / 2.2
    axis.imshow(np.clip(image, 0, 1) ** gamma)
    axis.set(title=title, xticks=[], yticks=[])
assert fit.error is not None
figure.suptitle(f"photographs under lights that were left out are {fit.error:.1%} off")
figure.savefig(folder / "dome.png", dpi=68)
print(f"wrote {folder / 'dome.png'}, and the photographs into {photographs}")
