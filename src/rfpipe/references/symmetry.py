"""Test whether a rig is coaxial, by the random patterns captured with level 0.

For any two of the random patterns and the all-on one, the light from the rays of the first to those
of the second must equal the light in the opposite direction (reciprocity, 2.10). Misalignment by
half a pixel causes an error of 45 % in relit pictures.
"""

from __future__ import annotations

import logging
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from rfpipe.array_types import Double, Float
from rfpipe.calibration.symmetry import (
    CONFIDENCE,
    SignPictures,
    measure_symmetry,
    random_signs,
)
from rfpipe.errors import CaptureError
from rfpipe.references.placement import placement_of
from rfpipe.references.reference_images import ReferenceImages
from rfpipe.storage.base import SYMMETRY, Storage

if TYPE_CHECKING:
    from rfpipe.methods import Method, MethodDescription, Options


_LOGGED = 0.2
"""Share of the accepted error from which the error is logged. Symmetric photography has 1.5 times
the predicted error."""

_MASKED = 0.5
"""Squared error caused by masked pixels, relative to their share of all pixels.

`measure_symmetry` divides ``|K 1|^2 + |K s|^2`` by ``16 |T p|^2``, since a picture under the
pattern ``p = (1 + s) / 2`` has the error ``K p / 2 = (K 1 + K s) / 4``. A masked pixel j misses
light in one direction, which adds at most ``F_j^2`` to each term, and ``|T p|^2`` is about
``|F|^2 / 4``. The ratio is thus ``2 / (16 / 4)`` times the share of ``|F|^2``."""

_MIN_EXCESS = 0.01
"""Relative excess of light that spoils pictures."""

_EXCESS_SIGNIFICANCE = 5.0
"""Standard errors from which an excess is significant."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Asymmetry:
    """Error of relit pictures that the assumption of a coaxial rig causes.

    Attributes
    ----------
    error, standard_error : float
        Relative to the norm of the pictures; 0 where the asymmetry may be noise.
    place : str
        Description of a displacement of the pictures, see `rfpipe.references.placement`; "" for
        pictures in place.
    excess : float
        Light of random pictures beyond that expected from the floodlit image, relative to the
        latter; 0 unless it is significant. Asymmetry doesn't cause it: ``1^T (T - T^T) 1 = 0``.
    """

    error: float
    standard_error: float
    place: str = ""
    excess: float = 0.0

    @property
    def text(self) -> str:
        """Description of the error and its likely cause."""
        text = (
            f"treating the rig as coaxial causes an error of {self.error:.1%} +- "
            f"{self.standard_error:.1%} in relit pictures"
        )
        if self.excess:
            return (
                f"{text}, but the light of random pictures is {self.excess:+.1%} of the floodlit "
                "image's above the expected one: the room's light changed (black it out), the rig "
                "or the scene moved, or the projector's light depends on its picture (switch "
                "dynamic contrast off)"
            )
        return f"{text}; {self.place}" if self.place else text

    @property
    def lower_bound(self) -> float:
        """Lower bound of the error, `CONFIDENCE` standard errors below it."""
        return self.error - CONFIDENCE * self.standard_error


def is_coaxial(
    asymmetry: Asymmetry,
    method: MethodDescription,
    options: Options,
    accepted: float,
    *,
    was_coaxial: bool = False,
) -> bool:
    """Test whether a method may treat a rig with a measured asymmetry as coaxial.

    Parameters
    ----------
    asymmetry : Asymmetry
    method : MethodDescription
        Method of the settings.
    options : Options
        Its options. A method with a target error accepts no larger asymmetry than the target.
    accepted : float
        Error of relit pictures up to which a rig counts as coaxial.
    was_coaxial : bool
        Whether a calibration found the rig coaxial.

    Raises
    ------
    CaptureError
        If the method needs a coaxial rig and the error exceeds the accepted one.
    """
    if method.needs_coaxial_rig and asymmetry.lower_bound > accepted:
        raise _not_coaxial(asymmetry, accepted, was_coaxial=was_coaxial)
    return asymmetry.lower_bound <= min(accepted, options.error_target or accepted)


def log_asymmetry(asymmetry: Asymmetry, accepted: float, chosen: Method[Any] | None) -> None:
    """Log the method that was chosen by an asymmetry, or an asymmetry near the accepted one."""
    if chosen is not None:
        _log.info(
            "treating the rig as coaxial causes an error of %.1f%% +- %.1f%% in relit pictures: "
            "continuing with %s",
            100 * asymmetry.error, 100 * asymmetry.standard_error, chosen.title.lower(),
        )  # fmt: skip
    elif asymmetry.lower_bound > _LOGGED * accepted:
        _log.warning("%s; %s", _not_symmetric(asymmetry), _limit(accepted))


def no_longer_coaxial(description: str) -> str:
    """Return the message for a rig that its calibration found coaxial; `description` is of now."""
    return (
        f"this rig was coaxial when it was calibrated; it no longer is: {description}. Check "
        "cables, mirroring and what may have moved, then calibrate again (rfpipe calibrate --again)"
    )


def _not_symmetric(asymmetry: Asymmetry) -> str:
    return f"the transport is not symmetric: {asymmetry.text}"


def _limit(accepted: float) -> str:
    return f"{accepted:.1%} are accepted (capture.asymmetry)"


def _not_coaxial(asymmetry: Asymmetry, accepted: float, *, was_coaxial: bool) -> CaptureError:
    """Return the error for a method that needs a coaxial rig."""
    limit = _limit(accepted)
    if asymmetry.excess:
        return CaptureError(
            f"{_not_symmetric(asymmetry)}, and {limit}", remedy="Fix this, and start over"
        )
    if was_coaxial:
        return CaptureError(f"{no_longer_coaxial(asymmetry.text)}. {limit}")
    return CaptureError(
        f"{_not_symmetric(asymmetry)}, and {limit}",
        remedy="Use a method for any rig, such as dual photography; or align a real rig's two "
        "devices to a fraction of a pixel, and focus both; a simulated one's matrix must equal its "
        "transpose",
    )


def measure_asymmetry(
    storage: Storage, references: ReferenceImages, brightness: Double | None = None
) -> dict[str, Any]:
    """Measure the asymmetry of a rig from the random patterns captured with level 0.

    Parameters
    ----------
    storage : Storage
        Level 0 is captured.
    references : ReferenceImages
    brightness : ndarray of float64, shape (n, C), optional
        Brightness of the lamp at each random pattern, divided out: its drift would look like
        asymmetry.

    Returns
    -------
    dict
        Entry for the manifest of level 0's merge; empty without random patterns.
    """
    if SYMMETRY not in storage.read_manifest(0, "capture"):
        return {}
    with storage.pictures(0, "capture", SYMMETRY) as store:
        count = store.shape[0]
        merged = [references.merge(store.read(index, index + 1), index) for index in range(count)]
    radiance = _flat(np.concatenate([picture.radiance for picture in merged]))
    variance = _flat(np.concatenate([picture.variance for picture in merged]))
    if brightness is not None:
        radiance /= brightness[:, None].astype(np.float32)
        variance /= np.square(brightness[:, None]).astype(np.float32)
    floodlit, floodlit_variance = (
        _flat(image[None])[0].astype(np.float64)
        for image in (references.floodlit, references.floodlit_variance)
    )
    signs = random_signs(references.floodlit.shape[:-1], count, seed=0)
    pictures = SignPictures(signs.reshape(count, -1), radiance, variance)
    error, standard_error = measure_symmetry(floodlit, floodlit_variance, pictures)
    # light of a masked pixel is missing in one direction only
    masked = _MASKED * float(np.mean(~np.isfinite(references.floodlit_variance)))
    error = float(np.sqrt(max(error**2 - masked, 0)))
    place, excess = _place(signs, pictures, floodlit), _excess(pictures, floodlit)
    asymmetry = Asymmetry(error, standard_error, place, excess)
    return {SYMMETRY: {**asdict(asymmetry), "brackets": count}}


def read_asymmetry(storage: Storage) -> Asymmetry | None:
    """Read the asymmetry measured with level 0; None where it wasn't measured."""
    facts = storage.read_manifest(0, "merge").get(SYMMETRY) if storage.exists(0, "merge") else None
    if facts is None:
        return None
    return Asymmetry(facts["error"], facts["standard_error"], facts["place"], facts["excess"])


def _excess(pictures: SignPictures, floodlit: Double) -> float:
    """Estimate the light of pictures beyond that expected, relative to the floodlit image's.

    On a coaxial rig ``1^T T p = p^T T 1``. Returns 0 unless the excess is significant.
    """
    grey = floodlit.sum(axis=-1)
    total = float(grey.sum()) or 1.0
    expected = (pictures.signs @ grey + total) / 2
    excess = (pictures.radiance.sum(axis=(1, 2), dtype=np.float64) - expected) / total
    mean, deviation = float(excess.mean()), float(excess.std(ddof=1) / np.sqrt(len(excess)))
    return mean if abs(mean) > max(_MIN_EXCESS, _EXCESS_SIGNIFICANCE * deviation) else 0.0


def _place(signs: Double, pictures: SignPictures, floodlit: Double) -> str:
    """Describe a displacement of the pictures; "" for none, and for a light field."""
    if signs.ndim != 3:
        return ""
    light = pictures.radiance.sum(axis=-1, dtype=np.float64).reshape(signs.shape)
    return placement_of(signs, light, floodlit.sum(axis=-1).reshape(signs.shape[1:])).text


def _flat(images: Float) -> Float:
    """Reshape images to (B, N, C); masked pixels become 0."""
    flat = images.reshape(len(images), -1, images.shape[-1])
    return np.where(np.isfinite(flat), flat, np.float32(0))
