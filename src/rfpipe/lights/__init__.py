"""Light from directions between measured lights, and the Lambertian part of pictures."""

from rfpipe.lights.interpolation import Interpolation, between, interpolate
from rfpipe.lights.shading import Shading, fit_shading

__all__ = ["Interpolation", "Shading", "between", "fit_shading", "interpolate"]
