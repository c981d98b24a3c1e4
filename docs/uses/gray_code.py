"""Photographs of Gray code in a folder, and the fit, places and relit pictures that follow.

Usage: ``python docs/uses/gray_code.py [SIDE [FOLDER]]``, by default 96 and results/uses. Writes
``FOLDER/gray_code.png``, and the photographs into ``FOLDER/gray_code``.
"""

import shutil
import sys
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
from matplotlib import pyplot

from rfpipe.fitting import fit_transport, read_series
from rfpipe.fitting.codes import code_patterns
from rfpipe.scenes import Pinhole, planes_scene

side = int(sys.argv[1]) if len(sys.argv) > 1 else 96
folder = Path(sys.argv[2] if len(sys.argv) > 2 else "results/uses")
folder.mkdir(parents=True, exist_ok=True)
code = f"gray:{side}x{side}"
camera, lamp = Pinhole((side, side)), Pinhole((side, side), (1.72, 0, 0.54), (0, 0, 3))
scene = planes_scene("wedge_120", ("white", "texture"), camera.shape, projector=lamp)

# photographs as somebody takes them: 8 bits, with noise, in the order of the code
count = 4 * int(np.ceil(np.log2(side))) + 2
white_and_black_last = np.r_[np.full(count - 2, 0.5), 1, 0]
patterns = [np.array(read()) for read in code_patterns(code, count, white_and_black_last).readers]
light = scene.apply(np.reshape(patterns, (count, -1)).astype(np.float32))
light *= 200 / np.quantile(light, 0.99)
counts = np.clip(light + 10 + 1.5 * np.random.default_rng(1).standard_normal(light.shape), 0, 255)
photographs = folder / "gray_code"
shutil.rmtree(photographs, ignore_errors=True)
photographs.mkdir()
for index, picture in enumerate(np.rint(counts).astype(np.uint8)):
    pixels = np.ascontiguousarray(picture.reshape(*camera.shape, -1))
    image = oiio.ImageBuf(pixels)
    image.specmod().attribute("oiio:ColorSpace", "lin_rec709_scene")  # linear, not sRGB
    image.write(str(photographs / f"im{index + 1:02d}.png"))

fit = fit_transport(read_series(photographs, patterns=code))  # as `rfpipe fit` does
matches = fit.transport.correspondence()
row, column = np.indices(lamp.shape) / side
pattern = ((8 * row).astype(int) + (8 * column).astype(int)) % 2  # not one of the code
truth = scene.apply(pattern.reshape(1, -1).astype(np.float32))[0].reshape(*camera.shape, -1)
relit, floodlit = (fit.transport.relight(light) for light in (pattern, np.ones(lamp.shape)))
white = np.quantile(floodlit, 0.99)
images = {
    f"1 of {count} photographs": counts[8].reshape(*camera.shape, -1) / 255,
    "floodlit": floodlit / white,
    "projector's column": np.where(matches.mask, matches.places[..., 1], np.nan),
    "relit by a new pattern": relit / white,
    "the scene under it": truth / np.quantile(scene.apply(np.ones((1, side**2), np.float32)), 0.99),
}
figure, axes = pyplot.subplots(1, 5, figsize=(11.5, 2.8), layout="constrained")
for axis, (title, image) in zip(axes, images.items(), strict=True):
    axis.imshow(np.clip(image, 0, 1) ** (1 / 2.2) if image.ndim == 3 else image)
    axis.set(title=title, xticks=[], yticks=[])
summary = f"by {fit.model}: held-out photographs are {fit.error:.1%} off"
figure.suptitle(f"{summary}, {fit.errors['the mean picture']:.0%} by the mean picture")
figure.savefig(folder / "gray_code.png", dpi=60)
print(f"wrote {folder / 'gray_code.png'}, and the photographs into {photographs}")
