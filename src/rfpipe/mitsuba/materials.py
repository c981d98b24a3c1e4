"""Light that a scene's materials call for, by the flags of their BSDFs.

A BSDF with a delta lobe, such as a mirror's or a smooth boundary's of glass, turns light into a
single direction: no path from the camera is connected with the projector by it, so that the light
is followed from the projector (`rfpipe.mitsuba.caustics`). Flags hold for nested BSDFs, too: masks,
blends, bumps, two sides.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from rfpipe.config import Choice
from rfpipe.errors import InputError
from rfpipe.mitsuba.variant import load_mitsuba

# Vertices of a path that are worth following. More than 6 add 0.02 % of all light to a matt ball on
# a floor, 0.6 % to a box with blocks, 0.1 % to a mirror ball. A ball of glass lacks 0.5 % at 6 and
# 0.01 % at 10, two shells of glass 2.4 % and 0.3 %; a ball of fog 3.5 % at 6, 0.2 % at 24.
_MATT_BOUNCES, _GLASS_BOUNCES, _BODY_BOUNCES = 6, 10, 48
# Paths hardly ever meet a sharper lobe. At 4,096 paths a pixel, the floor and wall behind a ball of
# rough glass are 4.5 % off at alpha 0.1, 14 % at 0.03, 41 % at 0.01; what a rough mirror throws is
# missing at 0.0001.
_SHARPEST_ALPHA = 0.05
_NAMED = 3  # surfaces that a sentence names


class Surface(NamedTuple):
    """One shape of a scene and its material.

    Attributes
    ----------
    name : str
        The shape's name in the scene, or its class, and the class of its BSDF.
    flags : int
        Flags of its BSDF, see Mitsuba's `BSDFFlags`.
    alpha : float or None
        Roughness of its sharpest glossy lobe; None where it has none that is known.
    is_filled : bool
        Whether it bounds a medium.
    is_graded : bool
        Whether that medium is heterogeneous.
    """

    name: str
    flags: int
    alpha: float | None
    is_filled: bool
    is_graded: bool

    def has(self, *names: str) -> bool:
        """Test its BSDF for any of the named flags."""
        flags = load_mitsuba().BSDFFlags
        return any(self.flags & int(getattr(flags, name)) for name in names)

    @property
    def is_smooth(self) -> bool:
        """True of mirrors, lenses and smooth coats: a lobe is a single direction."""
        return self.has("DeltaReflection", "DeltaTransmission")

    @property
    def refracts(self) -> bool:
        """True where light passes through it, bent by a smooth or a rough boundary."""
        return self.has("DeltaTransmission", "GlossyTransmission")

    @property
    def is_sharp(self) -> bool:
        """True where it has a glossy lobe that paths hardly ever meet."""
        return self.alpha is not None and self.alpha < _SHARPEST_ALPHA


def surfaces_of(scene: Any) -> list[Surface]:
    """Return the surfaces of a loaded scene, also those in groups of shapes."""
    mi = load_mitsuba()
    nodes = mi.traverse(scene).hierarchy
    groups = "Instance", "ShapeGroupPlugin"  # their shapes are nodes, too
    return [
        _surface(shape)
        for shape in nodes
        if isinstance(shape, mi.Shape) and shape.class_name() not in groups
    ]


def _surface(shape: Any) -> Surface:
    bsdf = shape.bsdf()
    media = [it for it in (shape.interior_medium(), shape.exterior_medium()) if it is not None]
    return Surface(
        f"{shape.id() or shape.class_name()} ({bsdf.class_name()})",
        int(bsdf.flags()),
        _sharpest(bsdf),
        bool(shape.is_medium_transition()),
        not all(medium.is_homogeneous() for medium in media),
    )


def _sharpest(bsdf: Any) -> float | None:
    """Return the least roughness alpha of a BSDF's lobes, of two directions the larger one."""
    lobes: dict[str, float] = {}
    parameters = load_mitsuba().traverse(bsdf)
    for key in parameters.keys():  # noqa: SIM118 - not a mapping: iterating it fails
        *nested, name = key.removesuffix(".value").removesuffix(".data").split(".")
        if name not in {"alpha", "alpha_u", "alpha_v", "roughness"}:
            continue
        rough = float(np.min(np.asarray(parameters[key])))
        alpha = rough**2 if name == "roughness" else rough  # as the principled BSDF has it
        lobe = ".".join(nested)
        lobes[lobe] = max(alpha, lobes.get(lobe, 0.0))
    return min(lobes.values(), default=None)


def check_traceable(surfaces: list[Surface], name: str) -> None:
    """Raise InputError where a surface bounds a heterogeneous medium, which isn't traced."""
    graded = [surface.name for surface in surfaces if surface.is_graded]
    if graded:
        raise InputError(
            f"scene {name}: {_named(graded)} is filled with a heterogeneous medium, which isn't "
            "traced; make it homogeneous, or leave it out"
        )


def choose_bounces(surfaces: list[Surface]) -> Choice:
    """Choose the vertices of a path of light that are followed."""
    bodies = [surface.name for surface in surfaces if surface.is_filled]
    if bodies:
        reason = f"light is scattered within {_named(bodies)}"
        return Choice("bounces", _BODY_BOUNCES, reason)
    glass = [surface.name for surface in surfaces if surface.refracts]
    if glass:
        return Choice("bounces", _GLASS_BOUNCES, f"light is refracted by {_named(glass)}")
    return Choice("bounces", _MATT_BOUNCES, "no surface refracts light, and none bounds a medium")


def choose_caustics(surfaces: list[Surface], bounces: int) -> Choice:
    """Choose whether light that mirrors and lenses throw is followed from the projector."""
    smooth = [surface.name for surface in surfaces if surface.is_smooth]
    if not smooth:
        return Choice("caustics", False, "no surface is a smooth mirror or lens")
    if bounces == 1:
        return Choice("caustics", False, "bounces is 1: direct light alone")
    reason = f"light is reflected or refracted smoothly by {_named(smooth)}"
    return Choice("caustics", True, reason)


def omissions_of(surfaces: list[Surface], bounces: int, *, caustics: bool) -> list[str]:
    """Return, a sentence each, what light of a scene isn't recorded as it is."""
    smooth = [surface.name for surface in surfaces if surface.is_smooth]
    sharp = [surface.name for surface in surfaces if surface.is_sharp]
    clear = [it.name for it in surfaces if it.is_filled and it.has("DeltaTransmission")]
    missing = smooth and bounces > 1 and not caustics
    sentences = {
        f"light that {_named(smooth)} throws on other surfaces is missing, and the transport of a "
        "coaxial rig not symmetric, as caustics is false: set it to null or true": missing,
        f"light that {_named(sharp)} throws on other surfaces is met by chance alone, and noisy "
        "or missing: make the material smooth (without roughness), or its alpha at least "
        f"{_SHARPEST_ALPHA:g}": sharp and bounces > 1,
        f"light within {_named(clear)} is not traced as it is: the boundary of a medium must be "
        "rough or of type null": clear,
    }
    return [sentence for sentence, applies in sentences.items() if applies]


def _named(names: list[str]) -> str:
    """Name some surfaces, the first ones of many."""
    more = len(names) - _NAMED
    return ", ".join(names[:_NAMED]) + (f" and {more} more" if more > 0 else "")
