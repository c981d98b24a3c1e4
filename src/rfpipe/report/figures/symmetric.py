"""Symmetric photography's figures on physically based scenes [thesis Fig. 5.6, 5.7, 5.11]."""

from __future__ import annotations

from rfpipe.report.blocks import Illustration, Section, Tabulation, table_of
from rfpipe.report.figures.panels import compared, draw_levels, exposure, light_of, size_of
from rfpipe.report.inputs import Study
from rfpipe.report.light import Light
from rfpipe.report.text import number, percent

__all__ = ["bears_section", "flare_section"]

_BRIGHTER = 0.6  # of the radiance that is white elsewhere: the letters glow within dark sweets


def bears_section(study: Study) -> Section:
    """Fig. 5.6 and 5.7."""
    row = study.rows[0]
    images = study.images.read
    whites = {name: exposure(images(f"{name}_truth")) for name in ("letters", "both")}
    whites["letters"] *= _BRIGHTER
    rows, pairs = [], []
    for name, what in (("letters", "letters from the front"), ("both", "and even light behind")):
        relit, truth = (
            light_of(study, key, told, whites[name])
            for key, told in ((name, what), (f"{name}_truth", f"{what}, ground truth"))
        )
        below = f"error {percent(row[f'{name}_error'])} %"
        rows.append([(what, relit, below), ("ground truth", truth, "")])
        pairs.append((relit, truth))
    projected = Light("projector", "letters", images("pattern")[..., None], 1.0, quantity="pattern")
    rows[0].insert(0, ("the front projector's pattern", projected, ""))
    white = Light("second projector", "even light", images("pattern")[..., None] * 0 + 1, 1.0,
                  quantity="pattern")  # fmt: skip
    rows[1].insert(0, ("the second projector's pattern", white, ""))
    caption = (
        "Translucent sweets in a tumbler before two coaxial pairs of projector and camera, 120 "
        "degrees apart; all pictures are seen from the front. Above, letters of light from the "
        "front, which glow within the sweets; below, with even light from the second pair as well. "
        f"{row['patterns']} patterns for {row['rays']:,} rays. {size_of(row)}"
    )
    first = Illustration("Fig. 5.6", caption, "fig_5_6", compared(rows, pairs), "Fig. 5.6")
    return Section(
        "bears",
        "Scattering bodies, two coaxial pairs (Fig. 5.6, 5.7)",
        [first, _levels_figure(study, whites["letters"])],
        (),
        [study.source],
    )


def _levels_figure(study: Study, white: float) -> Illustration:
    """Fig. 5.7, for the letters."""
    panels = []
    for level in study.rows[0]["levels"]:
        light = light_of(study, f"level_{level['level']}", f"level {level['level']}", white)
        below = f"patterns {level['patterns']}\nerror {percent(level['error'])} %"
        panels.append((f"level {level['level']}", light, below))
    truth = light_of(study, "letters_truth", "ground truth", white)
    caption = (
        "The picture by the letters as if the acquisition had stopped at each level, with the "
        "patterns shown up to there. Each picture has full resolution, but the letters' light is "
        "spread over whole blocks, which shrink level by level until the letters stand there. "
        "Below each picture its difference from the truth."
    )
    drawing = draw_levels(panels, ("ground truth", truth, ""), truth)
    return Illustration("Fig. 5.7", caption, "fig_5_7_physical", drawing, "Fig. 5.7")


def flare_section(study: Study) -> Section:
    """Fig. 5.11."""
    rows = {row["case"]: row for row in study.rows}
    white = exposure(study.images.read("truth"))
    pictures = {
        name: light_of(study, name, what, white, "glossy_metal")
        for name, what in (
            ("truth", "without flare"),
            ("flared", "seen through the lens"),
            ("tight", "tight threshold"),
            ("loose", "loose threshold"),
            ("without", "no flare, tight threshold"),
        )
    }
    panels = []
    for name in ("tight", "loose", "without"):
        row = rows[name]
        truth = "truth" if name == "without" else "flared"
        panels.append(
            [
                (pictures[truth].what, pictures[truth], "what the camera sees"),
                (
                    f"relit: {pictures[name].what}",
                    pictures[name],
                    (
                        f"tolerance {row['tolerance']:g}, {row['patterns']} patterns\n"
                        f"error {percent(row['error'])} %, at highlights {percent(row['around'])} %"
                    ),
                ),
            ]
        )
    pairs = [(panel[1][1], panel[0][1]) for panel in panels]
    caption = (
        "Gloss and rough metal in a box, coaxial, its right half lit. The camera's aperture "
        "spreads 3 % of each pixel's light over a star of six arms; the projector has no flare, so "
        "that the measured matrix isn't symmetric. Above at a tight threshold, in the middle at a "
        "loose one, below without flare for comparison."
    )
    figure = Illustration("Fig. 5.11", caption, "fig_5_11", compared(panels, pairs), "Fig. 5.11")
    table = table_of(
        study.rows,
        [("case", "case", str)],
        [
            ("tolerance", "tolerance", lambda value: f"{value:g}"),
            ("patterns", "patterns", number),
            ("error, %", "error", percent),
            ("at highlights, %", "around", percent),
        ],
        csv="flare.csv",
    )
    about = "Relative RMS error of the half-lit picture against what the camera sees of the scene."
    return Section(
        "flare",
        "Lens flare in the camera alone (Fig. 5.11)",
        [figure, Tabulation("Tight against loose", about, table)],
        (),
        [study.source],
    )
