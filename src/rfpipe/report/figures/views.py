"""An 8D reflectance field of a physically based scene [thesis Fig. 5.8]."""

from __future__ import annotations

from rfpipe.report.blocks import Illustration, Section
from rfpipe.report.figures.panels import compared, exposure, light_of, size_of
from rfpipe.report.inputs import Study
from rfpipe.report.light import Light
from rfpipe.report.light_fields import SHARED, draw_views
from rfpipe.report.text import number, percent, size

__all__ = ["views_section"]


def views_section(study: Study) -> Section:
    """Fig. 5.8."""
    row = study.rows[0]
    relit, truth = (study.images.read(f"views_{name}") for name in ("relit", "truth"))
    middle, grid = len(truth) // 2, tuple(row["grid"])
    about = (
        f"{size(*grid)} coaxial views of a painted wall, a block and a glossy ball, {SHARED} "
        f"{number(row['patterns'])} patterns for {number(row['rays'])} rays, at a tolerance of "
        f"{row['tolerance']:g}. {size_of(row)}"
    )
    figures = [
        Illustration(
            f"Fig. 5.8 ({letter}), the {name}",
            f"{what} {about}",
            f"fig_5_8_{letter}",
            draw_views(row["world"], grid, *pictures),
            "Fig. 5.8",
        )
        for letter, name, what, pictures in (
            (
                "a",
                "light moves",
                "The middle view, in the light of each view's projector in turn: shadows move.",
                (relit[:, middle], truth[:, middle]),
            ),
            (
                "b",
                "view moves",
                "The middle projector's light, seen from each view: near and far shift.",
                (relit[middle], truth[middle]),
            ),
        )
    ]
    return Section(
        "views",
        "An 8D field, 3 x 3 views (Fig. 5.8)",
        [*figures, _matte_figure(study)],
        (),
        [study.source],
    )


def _matte_figure(study: Study) -> Illustration:
    """The middle view in the matte of the first view's projector."""
    row = study.rows[0]
    images = study.images.read
    lit_by_each = images("views_truth")
    seen = lit_by_each.sum(axis=0)[len(lit_by_each) // 2]
    floodlit = Light(row["world"], "lit by all projectors", seen, exposure(seen))
    white = exposure(images("matte_truth"))
    relit, truth = (
        light_of(study, name, what, white)
        for name, what in (("matte", "relit"), ("matte_truth", "ground truth"))
    )
    pattern = Light("projector", "pattern", images("pattern")[..., None], 1.0, quantity="pattern")
    panels = [
        ("lit by all projectors", floodlit, "ground truth"),
        ("the first projector's pattern", pattern, "upper left of the array"),
        ("the middle view, relit", relit, f"error {percent(row['matte_error'])} %"),
        ("ground truth", truth, ""),
    ]
    caption = (
        "One view in the patterned light of another: the middle view when the projector at the "
        "array's upper left throws stripes and all others are dark. The stripes bend over what "
        "they meet, as a picture of the whole projector's light could not tell."
    )
    drawing = compared([panels], [(relit, truth)])
    return Illustration("Fig. 5.8, a pattern from aside", caption, "fig_5_8_c", drawing, "Fig. 5.8")
