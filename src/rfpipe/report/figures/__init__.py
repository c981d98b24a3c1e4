"""The thesis' figures and tables on physically based scenes, one section a study."""

from __future__ import annotations

from rfpipe.report.blocks import Section
from rfpipe.report.figures import claims, costs, dual, growth, laws, symmetric, views
from rfpipe.report.inputs import Inputs

__all__ = ["figures_sections"]

_OF_STUDY = {
    "walk": dual.walk_section,
    "box": dual.box_section,
    "bottle": dual.bottle_section,
    "samples": dual.samples_section,
    "growth": growth.growth_section,
    "arc": dual.arc_section,
    "right_angles": dual.right_angles_section,
    "bears": symmetric.bears_section,
    "flare": symmetric.flare_section,
    "views": views.views_section,
    "laws": laws.laws_section,
}


def figures_sections(inputs: Inputs) -> list[Section]:
    """Return a section for each study that was made, their costs, and the claims' table."""
    found = inputs.studies
    sections = [draw(found[name]) for name, draw in _OF_STUDY.items() if name in found]
    if not sections:
        return []
    return [claims.claims_section(inputs), *sections, costs.costs_section(inputs)]
