"""What each camera pixel sees of a projector that stands aside, and the depth behind it."""

import sys

import numpy as np
from matplotlib import pyplot

import rfpipe
from rfpipe.scenes import planes_scene
from rfpipe.scenes.sight import Pinhole
from rfpipe.transport.correspondence import write_ply

side = int(sys.argv[1]) if len(sys.argv) > 1 else 96
camera, lamp = Pinhole((side, side)), Pinhole((side, side), (1.72, 0, 0.54), (0, 0, 3))
scene = planes_scene("wedge_120", ("white", "texture"), camera.shape, projector=lamp)
rig = rfpipe.OperatorRig(scene, camera.shape, lamp.shape, rfpipe.CameraModel(), seed=1)
transport = rfpipe.acquire(rig, "auto", target_error=0.01).transport


def projection(pinhole: Pinhole) -> np.ndarray:
    """Return the matrix of a pinhole; of a real rig, OpenCV's stereo calibration has both."""
    height, width = pinhole.shape
    inner = np.diag([1 / pinhole.pitch, 1 / pinhole.pitch, 1])
    inner[:2, 2] = width / 2, height / 2
    return inner @ np.column_stack([pinhole.axes, -pinhole.axes @ pinhole.origin])


found = transport.correspondence()
points = found.points(projection(camera), projection(lamp))
picture = transport.relight(np.ones(lamp.shape))
shown = np.clip(picture / np.quantile(picture, 0.99), 0, 1) ** (1 / 2.2)
write_ply("cloud.ply", points, (255 * shown).astype(np.uint8))

figure, axes = pyplot.subplots(1, 4, figsize=(12, 3.2), layout="constrained")
column = np.where(found.mask, found.places[..., 1], np.nan)
pictures = {"floodlit": shown, "projector's column": column, "confidence": found.confidence,
            "depth": points[..., 2]}  # fmt: skip
for axis, (title, image) in zip(axes, pictures.items(), strict=True):
    low, high = np.nanquantile(image, (0.01, 0.99))
    axis.imshow(image, vmin=low, vmax=high)
    axis.set(title=title, xticks=[], yticks=[])
figure.savefig("what_sees_what.png")
