"""Automatic acquisition: a method for any rig and scene that needs only a target error."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from rfpipe.blocks import RayDomain
from rfpipe.methods.base import ErrorOptions, Forecast, Method, MethodDescription
from rfpipe.methods.footprints.method import Footprints
from rfpipe.methods.near_far.method import NearFar


class Auto(MethodDescription):
    """Near/far acquisition on coaxial rigs, footprint acquisition on all others and on views.

    Both continue with multiplexed dual photography if their model doesn't fit the light.
    """

    name = "auto"
    title = "Automatic acquisition"
    colour = "#2a2a2a"
    marker = "h"
    estimates_error = True
    uses_prior = True
    Options = ErrorOptions
    trades = "target_error"
    trials = NearFar.trials

    def measures_symmetry(self, camera: RayDomain, projector: RayDomain) -> bool:
        """Test whether the rig may be coaxial; views are for footprints in any case."""
        return camera.shape == projector.shape and projector.views == 1

    def for_rig(
        self, camera: RayDomain, projector: RayDomain, is_coaxial: bool | None = None
    ) -> Method[Any]:
        """Choose the method by the ray domains and, if measured, by the symmetry.

        If the symmetry isn't measured, a rig with one view and equal ray domains counts as coaxial.
        """
        may_be_coaxial = self.measures_symmetry(camera, projector)
        if not may_be_coaxial or is_coaxial is False:
            return Footprints()
        return NearFar()

    def forecast(
        self, camera: RayDomain, projector: RayDomain, channels: int, options: ErrorOptions
    ) -> Forecast:
        """Forecast the method of these ray domains; its bound is the larger one of both methods.

        The memory is that of a coaxial rig, unless the ray domains differ.
        """
        methods = [self.for_rig(camera, projector, is_coaxial) for is_coaxial in (None, False)]
        forecasts = [method.forecast(camera, projector, channels, options) for method in methods]
        max_patterns = max(forecast.max_patterns for forecast in forecasts)
        return replace(forecasts[0], max_patterns=max_patterns)
