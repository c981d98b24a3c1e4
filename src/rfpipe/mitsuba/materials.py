"""Choice of the tracing parameters by the flags of a scene's BSDFs.

A BSDF with a delta lobe, such as that of a mirror or a smooth glass surface, deflects light in a
single direction: it can't connect a path from the camera with the projector, so that this light is
traced from the projector (`rfpipe.mitsuba.caustics`). Flags include those of nested BSDFs, such as
masks, blends and two-sided BSDFs.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from rfpipe.config import Choice
from rfpipe.errors import InputError
from rfpipe.mitsuba.variant import load_mitsuba

# Maximum number of vertices of a path. More than 6 add 0.02 % of all light for a matt ball on a
# floor, 0.6 % for a box with blocks, 0.1 % for a mirror ball. For a glass ball, 0.5 % are missing
# at 6 and 0.01 % at 10; for two glass shells 2.4 % and 0.3 %; for a ball of fog 3.5 % at 6
# and 0.2 % at 24.
_MATT_BOUNCES, _GLASS_BOUNCES, _BODY_BOUNCES = 6, 10, 48
# Paths rarely hit a sharper lobe. At 4,096 paths per pixel, the floor and wall behind a ball of
# rough glass have errors of 4.5 % at alpha 0.1, 14 % at 0.03 and 41 % at 0.01; caustics of a rough
# mirror are missing at 0.0001.
_SHARPEST_ALPHA = 0.05
_MAX_LISTED = 3  # surfaces in a sentence


class ShapeMaterial(NamedTuple):
    """One shape of a scene and its material.

    Attributes
    ----------
    name : str
        The shape's name in the scene, or its class, and the class of its BSDF.
    flags : int
        Flags of its BSDF, see Mitsuba's `BSDFFlags`.
    alpha : float or None
        Roughness of its sharpest glossy lobe; None if unknown or without one.
    is_filled : bool
        True if it bounds a medium.
    is_graded : bool
        True if that medium is heterogeneous.
    """

    name: str
    flags: int
    alpha: float | None
    is_filled: bool
    is_graded: bool

    def has(self, *names: str) -> bool:
        """Test whether the BSDF has any of these flags."""
        flags = load_mitsuba().BSDFFlags
        return any(self.flags & int(getattr(flags, name)) for name in names)

    @property
    def is_smooth(self) -> bool:
        """True for mirrors, lenses and smooth coatings: a lobe is a single direction."""
        return self.has("DeltaReflection", "DeltaTransmission")

    @property
    def refracts(self) -> bool:
        """True if it refracts light, at a smooth or rough boundary."""
        return self.has("DeltaTransmission", "GlossyTransmission")

    @property
    def is_sharp(self) -> bool:
        """True if it has a glossy lobe that paths rarely hit."""
        return self.alpha is not None and self.alpha < _SHARPEST_ALPHA


def shape_materials(scene: Any) -> list[ShapeMaterial]:
    """List the surfaces of a loaded scene, including those in groups of shapes."""
    mi = load_mitsuba()
    nodes = mi.traverse(scene).hierarchy
    groups = "Instance", "ShapeGroupPlugin"  # their shapes are listed as well
    return [
        _surface(shape)
        for shape in nodes
        if isinstance(shape, mi.Shape) and shape.class_name() not in groups
    ]


def _surface(shape: Any) -> ShapeMaterial:
    bsdf = shape.bsdf()
    media = [it for it in (shape.interior_medium(), shape.exterior_medium()) if it is not None]
    return ShapeMaterial(
        f"{shape.id() or shape.class_name()} ({bsdf.class_name()})",
        int(bsdf.flags()),
        _sharpest(bsdf),
        bool(shape.is_medium_transition()),
        not all(medium.is_homogeneous() for medium in media),
    )


def _sharpest(bsdf: Any) -> float | None:
    """Return the smallest roughness alpha of a BSDF's lobes; anisotropic: the larger of two."""
    lobes: dict[str, float] = {}
    parameters = load_mitsuba().traverse(bsdf)
    for key in parameters.keys():  # noqa: SIM118 - not a mapping: iterating it fails
        *nested, name = key.removesuffix(".value").removesuffix(".data").split(".")
        if name not in {"alpha", "alpha_u", "alpha_v", "roughness"}:
            continue
        rough = float(np.min(np.asarray(parameters[key])))
        alpha = rough**2 if name == "roughness" else rough  # of the principled BSDF
        lobe = ".".join(nested)
        lobes[lobe] = max(alpha, lobes.get(lobe, 0.0))
    return min(lobes.values(), default=None)


def check_traceable(surfaces: list[ShapeMaterial], name: str) -> None:
    """Raise InputError if a surface bounds a heterogeneous medium, which can't be traced."""
    graded = [surface.name for surface in surfaces if surface.is_graded]
    if graded:
        raise InputError(
            f"scene {name}: {_list(graded)} is filled with a heterogeneous medium, which "
            "can't be traced; make it homogeneous, or remove it"
        )


def choose_bounces(surfaces: list[ShapeMaterial]) -> Choice:
    """Choose the maximum number of vertices of a path."""
    bodies = [surface.name for surface in surfaces if surface.is_filled]
    if bodies:
        reason = f"light is scattered within {_list(bodies)}"
        return Choice("bounces", _BODY_BOUNCES, reason)
    glass = [surface.name for surface in surfaces if surface.refracts]
    if glass:
        return Choice("bounces", _GLASS_BOUNCES, f"light is refracted by {_list(glass)}")
    return Choice("bounces", _MATT_BOUNCES, "no surface refracts light, and none bounds a medium")


def choose_caustics(surfaces: list[ShapeMaterial], bounces: int) -> Choice:
    """Choose whether to trace light from the projector through mirrors and lenses."""
    smooth = [surface.name for surface in surfaces if surface.is_smooth]
    if not smooth:
        return Choice("caustics", False, "no surface is a smooth mirror or lens")
    if bounces == 1:
        return Choice("caustics", False, "bounces is 1: direct light only")
    reason = f"light is reflected or refracted smoothly by {_list(smooth)}"
    return Choice("caustics", True, reason)


def omissions_of(surfaces: list[ShapeMaterial], bounces: int, *, caustics: bool) -> list[str]:
    """Describe the light of a scene that isn't recorded correctly, one sentence per cause."""
    smooth = [surface.name for surface in surfaces if surface.is_smooth]
    sharp = [surface.name for surface in surfaces if surface.is_sharp]
    clear = [it.name for it in surfaces if it.is_filled and it.has("DeltaTransmission")]
    missing = smooth and bounces > 1 and not caustics
    sentences = {
        f"caustics of {_list(smooth)} are missing, and the transport of a coaxial rig isn't "
        "symmetric, since caustics is false: set it to null or true": missing,
        f"caustics of {_list(sharp)} are noisy or missing, since its lobe is too sharp: make the "
        f"material smooth (without roughness), or its alpha at least {_SHARPEST_ALPHA:g}": (
            sharp and bounces > 1
        ),
        f"light within {_list(clear)} isn't traced correctly: make the boundary of the medium "
        "rough or of type null": clear,
    }
    return [sentence for sentence, applies in sentences.items() if applies]


def _list(names: list[str]) -> str:
    """Join the names of the first surfaces, with the number of further ones."""
    more = len(names) - _MAX_LISTED
    return ", ".join(names[:_MAX_LISTED]) + (f" and {more} more" if more > 0 else "")
