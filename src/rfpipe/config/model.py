"""The model of a run's settings: names, units, ranges and defaults.

Plain data only: the layers above build cameras, scenes and methods from it.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property, partial
from math import prod
from typing import Any, Literal, Self

from pydantic import ConfigDict, Field, SerializeAsAny, ValidationError, model_validator

from rfpipe.config.base import (
    MethodSections,
    MethodSettings,
    SectionName,
    Settings,
    Text,
    group_of,
    merged,
    mistake,
    setting,
)
from rfpipe.config.camera import CameraConfig
from rfpipe.config.capture import (
    CaptureConfig,
    Command,
    MergeConfig,
    Normalization,
    OfflineConfig,
    ReportConfig,
    ResourcesConfig,
    StorageConfig,
    VerificationConfig,
)
from rfpipe.config.scenes import SceneSettings
from rfpipe.provenance import fingerprint

# Folders of a run's results that are no scene's.
_OTHER_FOLDERS = {"catalogue", "report", "verified"}

TARGET_MARGIN = 1.5
"""Measured errors at most this many times a target meet it.

Where a method ended at its target by its own estimate, errors of 96 pictures were at most 1.2 times
the target on the open scenes of ``docs/benchmark``; the mean of nine pictures scatters more.
"""

SMALL_RAYS = 4000
"""Rays up to which an acquisition is one job where the settings don't say what a job is.

Starting a job takes 1.4 s of processor time: four scenes of 16 x 18 rays took 125 s as 80 jobs,
32 s as 15. Five levels of five stages are 35 s of it; the work of all stages takes 11 s in the
median at 2,304 rays (``processing_s`` of ``docs/benchmark``, ``auto`` for 1 %) and grows with the
rays.
"""

# Those of a run that names none, in the order of its report.
DEFAULT_METHODS = ("near_far", "symmetric", "dual")

# Options that no scene has of its own, of the groups that a scene may have of its own.
_OF_THE_RUN = {"capture": ("rig",), "resources": ("jobs", "captures"), "storage": ("keep_at",)}


# Settings of a capture that neither shape a result nor describe one.
_NOT_SHAPING = {
    *("batch_patterns", "keep_raw", "when_patterns_change"),
    *("url", "token_file", "patience_seconds", "placing"),
}


def _scenes_or_a_collection(schema: dict[str, Any]) -> None:
    """Say in a JSON schema that scenes may stand in a collection, which is read before."""
    schema["anyOf"] = [{"required": [name]} for name in ("scenes", "collection")]
    del schema["required"]


class Config(Settings):
    """All settings of a run."""

    model_config = ConfigDict(json_schema_extra=_scenes_or_a_collection)

    seed: int = setting(1, "Seed of the captures' noise, an integer.", ge=0)
    scenes: dict[SectionName, SerializeAsAny[SceneSettings]] = Field(
        min_length=1,
        description="The scenes by name: lower-case letters, digits and _.",
    )
    collection: Text | None = setting(
        None, "A CSV file whose rows are scenes, too (docs/collections.md); or null."
    )
    rigs: dict[SectionName, dict[str, Any]] = setting(
        {}, "Settings that the scenes before one rig share, as in {studio: {camera: {bits: 14}}}."
    )
    methods: MethodSections = Field(
        default_factory=lambda: dict.fromkeys(DEFAULT_METHODS),
        validate_default=True,
        description="Methods to acquire each scene with, each with its options, as in {symmetric: "
        "{}}.",
    )
    camera: CameraConfig | None = Field(
        default_factory=CameraConfig,
        description="The simulated or offline rig's camera; null for exact radiance.",
    )
    capture: CaptureConfig = group_of(CaptureConfig)
    merge: MergeConfig = group_of(MergeConfig)
    normalization: Normalization = setting(
        "per_channel",
        "Scaling of a level to the floodlit image [B.2]; total_energy is the thesis'.",
    )
    verification: VerificationConfig = group_of(VerificationConfig)
    offline: OfflineConfig = group_of(OfflineConfig)
    rig_file: Text | None = setting(
        None, "Settings of the rig that 'rfpipe run calibrate' calibrates, or null."
    )
    storage: StorageConfig = group_of(StorageConfig)
    resources: ResourcesConfig = group_of(ResourcesConfig)
    notify: Command | None = setting(
        None, "Command for a run's end, with RFPIPE_STATUS (done, failed) and RFPIPE_LOG; or null."
    )
    report: ReportConfig = group_of(ReportConfig)

    def methods_of(self, scene: str) -> dict[str, MethodSettings]:
        """Methods to acquire a scene with, and their options: its own, or those of the run."""
        return self.scenes[scene].methods or self.methods

    @cached_property
    def _base(self) -> dict[str, Any]:
        """All settings but the scenes, to be put others over."""
        return self.model_dump(exclude={"scenes", "collection", "rigs"})

    @cached_property
    def _by_overrides(self) -> dict[str, Config]:
        return {}

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return a copy, which finds anew what is derived from the settings."""
        copied = super().model_copy(update=update, deep=deep)
        for derived in ("_base", "_by_overrides", "acquisitions", "jobs_and_reason"):
            copied.__dict__.pop(derived, None)
        return copied

    def of_scene(self, scene: str) -> Config:
        """Return the settings that hold for a scene alone: its own over its rig's over the run's.

        Raises
        ------
        ValidationError
            When these are wrong.
        """
        about = self.scenes[scene]
        rig = self.rigs[about.rig] if about.rig else {}
        if not rig and not about.settings:
            return self
        overrides = merged(rig, about.settings)
        # scenes that share these settings share what is checked of them
        key, cache = fingerprint(overrides), self._by_overrides
        if key not in cache:
            cache[key] = self._with(scene, overrides)
        return cache[key].model_copy(update={"scenes": {scene: about}})

    def _with(self, scene: str, own: Mapping[str, Any]) -> Config:
        """Return settings of one scene, with others put over those of the run."""
        names = ", ".join(sorted(OWN_TO_SCENES))
        problems = [
            mistake(f"can't be set for a scene; expected settings among {names}", name)
            for name in own
            if name not in OWN_TO_SCENES
        ] + [
            mistake("can't be set for a scene: it holds for a whole run", group, option)
            for group, options in _OF_THE_RUN.items()
            for option in options
            if isinstance(own.get(group), Mapping) and option in own[group]
        ]
        if problems:
            raise ValidationError.from_exception_data("settings", problems)
        alone = self.scenes[scene].model_copy(update={"settings": {}, "rig": None})
        return Config.model_validate(merged({**self._base, "scenes": {scene: alone}}, own))

    @property
    def verification_pictures(self) -> int:
        """Pictures that verify each acquisition, 0 for none."""
        count = self.verification.pictures
        return self.capture.precautions.verification_pictures if count is None else count

    @property
    def divides_out_drift(self) -> bool:
        """Whether images are divided by the lamp's brightness."""
        divides = self.merge.divide_out_drift
        return self.capture.precautions.divide_out_drift if divides is None else divides

    def bound_of(self, scene: str, method: str) -> float | None:
        """Return the mean error above which an acquisition fails the run; None for none.

        The error is measured by pictures for verification, or else the method's estimate.
        """
        of_scene = self.of_scene(scene)
        bound = of_scene.verification.fail_above
        if bound is not None or self.capture.rig == "simulated":
            return bound
        target = getattr(self.methods_of(scene)[method], "target_error", None)
        margin = TARGET_MARGIN if of_scene.verification_pictures else 1.0
        return None if target is None else margin * float(target)

    @property
    def title(self) -> str:
        """The report's title."""
        many = len(self.scenes)
        of = f"{many} scenes" if many > 1 else next(iter(self.scenes))
        return self.report.title or f"Light transport of {of}"

    @property
    def has_report(self) -> bool:
        """Whether the run ends with a report."""
        page = self.report.page
        return self.collection is None if page is None else page

    @property
    def jobs(self) -> Literal["stage", "acquisition"]:
        """What a job of the workflow is."""
        return self.jobs_and_reason[0]

    @cached_property
    def jobs_and_reason(self) -> tuple[Literal["stage", "acquisition"], str]:
        """What a job of the workflow is, and why, for messages. No result depends on it."""
        if self.resources.jobs is not None:
            return self.resources.jobs, "as resources.jobs says"
        if self.collection:
            return "acquisition", "as in every collection"
        if any(self.of_scene(scene).capture.placing for scene in self.scenes):
            return "acquisition", "since scenes are placed one after the other (capture.placing)"
        if self.capture.rig == "offline":
            return "stage", "since its pictures are taken elsewhere, level by level"
        rays = max(prod(scene.ray_shape) for scene in self.scenes.values())
        if rays <= SMALL_RAYS:
            return "acquisition", (
                f"since no scene has more than {SMALL_RAYS:,} rays, and starting jobs would take "
                "longer than their work"
            )
        return "stage", f"since a scene has {rays:,} rays"

    def shaping(self) -> dict[str, Any]:
        """Return all settings as plain data but those that shape no result."""
        return self.model_dump(
            mode="json",
            exclude={
                "resources": True,
                "notify": True,
                "rig_file": True,
                "collection": True,
                "scenes": {"__all__": {"about"}},
                "capture": _NOT_SHAPING,
                "storage": {"keep_at"},
            },
        )

    @cached_property
    def acquisitions(self) -> list[tuple[str, str]]:
        """Scene and method of every acquisition."""
        return [(scene, method) for scene in self.scenes for method in self.methods_of(scene)]

    @model_validator(mode="before")
    @classmethod
    def _scenes_have_methods(cls, settings: Any) -> Any:
        """Put the options of a scene's methods over those of the run's."""
        if not isinstance(settings, Mapping):
            return settings
        if settings.get("collection") and "scenes" not in settings:
            raise ValueError("collection is read by load_config and parse_config alone")
        scenes, run = settings.get("scenes"), settings.get("methods")
        if not isinstance(scenes, Mapping) or not isinstance(run, Mapping):
            return settings
        filled = dict(scenes)
        for name, scene in scenes.items():
            methods = scene.get("methods") if isinstance(scene, Mapping) else None
            if isinstance(methods, Mapping):
                of_run = {method: run.get(method) or {} for method in methods}
                options = {method: {} if it is None else it for method, it in methods.items()}
                filled[name] = {**scene, "methods": merged(of_run, options)}
        return {**settings, "scenes": filled}

    @model_validator(mode="after")
    def _scenes_have_folders_and_rigs(self) -> Self:
        first: dict[str, tuple[str, str]] = {}
        for scene, method in self.acquisitions:
            page = f"{scene}_{method}"
            other, by = first.setdefault(page, (scene, method))
            rig = self.scenes[scene].rig
            if scene in _OTHER_FOLDERS:
                raise ValueError(
                    f"scenes.{scene} should be called otherwise: results/{scene} is the folder of "
                    "something else"
                )
            if other != scene:
                raise ValueError(
                    f"scenes.{scene} should be called otherwise, or its method: by {method} its "
                    f"page would be {page}, as that of {other} by {by} is"
                )
            if rig is not None and rig not in self.rigs:
                raise ValueError(
                    f"scenes.{scene}.rig is {rig!r}; the settings' rigs are: "
                    f"{', '.join(self.rigs) or 'none'}. Add it to rigs, or leave it out"
                )
        return self

    @model_validator(mode="after")
    def _own_settings_are_settings(self) -> Self:
        first = next(iter(self.scenes))
        rigs = {("rigs", name): partial(self._with, first, rig) for name, rig in self.rigs.items()}
        scenes = {
            ("scenes", name, "settings"): partial(self.of_scene, name)
            for name, scene in self.scenes.items()
            if scene.rig or scene.settings
        }
        for checks in (rigs, scenes):  # a wrong rig's scenes are no further mistakes
            problems = []
            for place, check in checks.items():
                try:
                    check()
                except ValidationError as error:
                    problems += [
                        mistake(self._message(it), *place, *it["loc"], of=it)
                        for it in error.errors()
                    ]
            if problems:
                raise ValidationError.from_exception_data("settings", problems)
        return self

    @model_validator(mode="after")
    def _scenes_fit_the_rig(self) -> Self:
        kind, many = self.capture.rig, len(self.scenes) > 1
        placed = [name for name in self.scenes if self.of_scene(name).capture.placing]
        if many and (
            kind == "offline" or (kind == "remote" and len(placed) < len(self.scenes) - 1)
        ):
            raise ValueError(
                f"scenes should be one with capture.rig {kind}, not {len(self.scenes)}: a rig sees "
                "one at a time; give each settings of its own, or, with a remote one, set "
                "capture.placing, a command that puts each in its place"
            )
        for name, scene in self.scenes.items():
            if scene.is_captured and kind == "simulated":
                raise ValueError(
                    f"capture.rig should be remote or offline for scenes.{name}, which is a real "
                    "scene, not a simulated one"
                )
            for method, section in self.methods_of(name).items():
                if section.subject.needs_coaxial_rig and not scene.is_coaxial:
                    raise ValueError(
                        f"scenes.{name}.methods should be methods for any rig, such as {{dual: "
                        f"{{}}}}: {method} needs a coaxial one, whose camera and projector share "
                        "their rays"
                    )
            camera = self.of_scene(name).camera
            bayer = None if camera is None else camera.bayer
            if bayer is not None and scene.channels != 3 and not scene.is_captured:
                raise ValueError(
                    f"camera.bayer {bayer} needs scenes of 3 channels, but "
                    f"scenes.{name}.channels is {scene.channels}; set it to 3, or bayer to null"
                )
        return self

    @model_validator(mode="after")
    def _pictures_can_be_taken(self) -> Self:
        if self.verification.fail_above is not None and not self.verification_pictures:
            raise ValueError(
                "verification.pictures should be 1 to 96 with verification.fail_above; this run "
                "takes none"
            )
        return self


OWN_TO_SCENES = frozenset(Config.model_fields) - {
    *("collection", "methods", "notify", "report", "rig_file", "rigs", "scenes")
}
"""Groups of a run's settings that a scene may have of its own."""
