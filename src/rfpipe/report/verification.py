"""Pictures that no method saw, captured and relit; and what else tells of the rig's day."""

from __future__ import annotations

from typing import Any

from rfpipe.report.blocks import Block, Gallery, Picture, Section, Tabulation, table_of
from rfpipe.report.inputs import Inputs, Run
from rfpipe.report.text import DASH, fixed, number, percent, words

__all__ = ["verification_section"]


# What devices count of a capture without faults.
_USUAL = (" frames", " shown", " played", " doubted", " loaded_again", " one_by_one")


def verification_section(inputs: Inputs) -> Section | None:
    """What each transport is wrong by on pictures that were captured for this alone."""
    runs = [run for run in inputs.runs if run.verified]
    if not runs:
        return None
    blocks: list[Block] = [
        Tabulation("Verification", _ABOUT, _of_runs(inputs, runs), is_folded=False),
        *(Gallery(_pictures(run)) for run in runs),
        Tabulation("Verification, picture by picture", _BY_PICTURE, _by_picture(inputs, runs)),
        Tabulation("The rig during the capture", _OF_THE_RIG, _rig(inputs, runs), is_folded=False),
    ]
    title = "Verified by pictures that no method saw"
    return Section("verification", title, blocks, _text(inputs, runs))


def _text(inputs: Inputs, runs: list[Run]) -> list[str]:
    """Sum it up, with all that was wrong."""
    bound = inputs.config.verification.fail_above
    said = []
    for run in runs:
        facts = run.verified
        text = (
            f"{run.title}, {run.method_title.lower()}: {len(facts['pictures'])} pictures are relit "
            f"to {percent(facts['mean_error'])} % on average, the worst, {facts['worst_picture']}, "
            f"to {percent(facts['worst_error'])} %; the noise floor is {percent(facts['noise'])} %."
        )
        if bound is not None:
            is_above = facts["mean_error"] is None or facts["mean_error"] > bound
            text += (
                f" THIS IS ABOVE the {percent(bound)} % that was accepted."
                if is_above
                else f" At most {percent(bound)} % was accepted."
            )
        said += [text, *(f"NOTICED DURING THE CAPTURE, {alarm}." for alarm in facts["alarms"])]
    return said


def _of_runs(inputs: Inputs, runs: list[Run]) -> Any:
    return table_of(
        [{"scene": run.scene, "method": run.method, **_flat(run.verified)} for run in runs],
        inputs.labels,
        [
            ("pictures", "pictures", number),
            ("mean", "mean_error", percent),
            ("largest", "worst_error", percent),
            ("under", "worst_picture", words),
            ("noise floor", "noise", percent),
        ],
        [("", 3), ("error, %", 3), ("of the pictures, %", 1)],
        csv="verification.csv",
    )


def _flat(facts: dict[str, Any]) -> dict[str, Any]:
    names = ("mean_error", "worst_error", "worst_picture", "noise")
    return {"pictures": len(facts["pictures"]), **{name: facts[name] for name in names}}


def _by_picture(inputs: Inputs, runs: list[Run]) -> Any:
    rows = [
        {"scene": run.scene, "method": run.method, **picture}
        for run in runs
        for picture in run.verified["pictures"]
    ]
    columns = [
        ("error, %", "error", percent),
        ("its standard error, %", "standard_error", percent),
        ("noise floor, %", "noise", percent),
        ("difference with noise, %", "difference", percent),
    ]
    labels = [*inputs.labels, ("picture", "name", words)]
    return table_of(rows, labels, columns, csv="verification_pictures.csv")


def _rig(inputs: Inputs, runs: list[Run]) -> Any:
    rows = [_of_the_rig(run) for run in runs]
    columns = [
        ("lamp, %", "drift", percent),
        ("the picture, %", "moved", percent),
        ("standard deviations", "reciprocity_deviations", fixed(1)),
        ("error at least, %", "reciprocity", percent),
        ("samples", "saturated", number),
        ("per cent", "saturated_share", percent),
        ("failed, lost or late", "troubled", _count),
        ("reconnected, reopened", "reconnected", _count),
    ]
    groups = [
        ("", 2), ("largest change of", 2), ("reciprocity", 2), ("saturated", 2),
        ("devices: frames and attempts", 2),
    ]  # fmt: skip
    return table_of(rows, inputs.labels, columns, groups, csv="verification_rig.csv")


def _of_the_rig(run: Run) -> dict[str, Any]:
    facts = run.verified
    names = ("drift", "moved", "reciprocity", "reciprocity_deviations", "saturated")
    devices: dict[str, int] = facts["devices"]
    again = {name for name in devices if name.endswith(("reconnected", "reopened"))}
    # what was doubted and found right, or shown in another way, isn't lost
    usual = {name for name in devices if name.endswith(_USUAL)}
    return {
        "scene": run.scene,
        "method": run.method,
        **{name: facts[name] for name in names},
        "saturated_share": facts["saturated"] / max(facts["samples"], 1),
        "troubled": sum(devices[name] for name in set(devices) - again - usual)
        if devices
        else None,
        "reconnected": sum(devices[name] for name in again) if devices else None,
        **devices,
    }


def _count(value: float | None) -> str:
    return DASH if value is None else number(value)


def _pictures(run: Run) -> list[Picture]:
    """Show each picture as relit and as captured, and their difference."""
    assert run.verified_images is not None
    relit, captured = (run.verified_images.read(name) for name in ("relit", "captured"))
    if len(run.settings.camera_ray_shape) > 2:
        relit, captured = (images[:, run.middle_view] for images in (relit, captured))
    found = []
    for index, picture in enumerate(run.verified["pictures"]):
        name = picture["name"]
        light = [run.light("relit", relit[index]), run.light("captured", captured[index])]
        caption = (
            f"{run.method_title}: error {percent(picture['error'])} % (noise floor "
            f"{percent(picture['noise'])} %)."
        )
        slug = f"verified_{run.scene}_{run.method}_{name}"
        title = f"{run.title}, {words(name)}"
        found.append(Picture(title, caption, slug, light, (0, 1)))
    return found


_ABOUT = (
    "Pictures that were captured after the acquisition for this alone, beside what the acquired "
    "transport makes of their patterns: relative RMS difference on the rays that the camera knows, "
    "its brightness brought to that at the acquisition's beginning, the captured picture's own "
    "noise taken off. The noise floor is that noise. The natural picture is made of overlapping "
    "discs in shades of grey, which have a photograph's statistics; it and the slope need a "
    "projector whose response is known, the others are of light and dark alone."
)

_BY_PICTURE = (
    "The error is the difference without the noise's share, 0 where nothing but noise is seen."
)

_OF_THE_RIG = (
    "Largest change of the lamp's light between looks at the floodlit image, which the "
    "verification takes at its beginning and end; of a fine random pattern that is repeated to see "
    "whether the rig moved, beyond brightness and noise; the largest residual of reciprocity "
    "between the patterns of a method that takes the rig for a coaxial one (a right rig has about "
    "1), and the error that it means at least; samples saturated at every exposure; and what the "
    "devices counted. A dash: not looked at."
)
