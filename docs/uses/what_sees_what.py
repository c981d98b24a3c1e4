"""What each camera pixel sees of a projector that stands aside, and the depth behind it.

Usage: ``python docs/uses/what_sees_what.py [SIDE [FOLDER]]``, by default 96 and results/uses.
Writes ``FOLDER/what_sees_what.png`` and ``FOLDER/cloud.ply``, and nothing else.
"""

import sys
from pathlib import Path

import cv2
import numpy as np
from matplotlib import pyplot

import rfpipe
from rfpipe.scenes import planes_scene
from rfpipe.scenes.pinholes import Pinhole

side = int(sys.argv[1]) if len(sys.argv) > 1 else 96
folder = Path(sys.argv[2] if len(sys.argv) > 2 else "results/uses")
folder.mkdir(parents=True, exist_ok=True)
camera, lamp = Pinhole((side, side)), Pinhole((side, side), (1.72, 0, 0.54), (0, 0, 3))
scene = planes_scene("wedge_120", ("white", "texture"), camera.shape, projector=lamp)
rig = rfpipe.OperatorRig(scene, camera.shape, lamp.shape, rfpipe.CameraModel(), seed=1)
transport = rfpipe.acquire(rig, "auto", target_error=0.01).transport
found = transport.correspondence()
seen = found.mask
sides = (np.argwhere(seen)[:, ::-1].T + 0.5, found.places[seen][:, ::-1].T.astype(float))
# of a real rig, OpenCV's stereo calibration gives both matrices
point = cv2.triangulatePoints(camera.matrix, lamp.matrix, *sides)
depth = np.full(seen.shape, np.nan)
depth[seen] = point[2] / point[3]

picture = transport.relight(np.ones(lamp.shape))
shown = np.clip(picture / np.quantile(picture, 0.99), 0, 1) ** (1 / 2.2)
kinds = ("float x", "float y", "float z", "uchar red", "uchar green", "uchar blue")
head = "".join(f"property {kind}\n" for kind in kinds) + "end_header"
head = f"ply\nformat ascii 1.0\nelement vertex {seen.sum()}\n{head}"
cloud = np.column_stack([(point[:3] / point[3]).T, (255 * shown[seen]).astype(int)])
np.savetxt(folder / "cloud.ply", cloud, fmt="%.5f %.5f %.5f %d %d %d", header=head, comments="")

figure, axes = pyplot.subplots(1, 4, figsize=(12, 3.2), layout="constrained")
column = np.where(seen, found.places[..., 1], np.nan)
titles = ("floodlit", "projector's column", "confidence", "depth")
for axis, title, image in zip(axes, titles, (shown, column, found.confidence, depth), strict=True):
    axis.imshow(image, vmin=np.nanquantile(image, 0.01), vmax=np.nanquantile(image, 0.99))
    axis.set(title=title, xticks=[], yticks=[])
figure.savefig(folder / "what_sees_what.png")
print(f"wrote {folder / 'what_sees_what.png'} and {folder / 'cloud.ply'}")
