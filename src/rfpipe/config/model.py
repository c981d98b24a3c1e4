"""Model of a run's settings: names, units, ranges and defaults.

It holds plain data only; the layers above build cameras, scenes and methods from it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cached_property, partial
from math import prod
from typing import Any, Literal, Self

from pydantic import ConfigDict, Field, SerializeAsAny, ValidationError, model_validator

from rfpipe.config.base import (
    RESERVED_ON_WINDOWS,
    MethodSections,
    MethodSettings,
    SectionName,
    Settings,
    Text,
    group_of,
    merge_settings,
)
from rfpipe.config.camera import CameraConfig
from rfpipe.config.capture import (
    CaptureConfig,
    MergeConfig,
    OfflineConfig,
    ReportConfig,
    ResourcesConfig,
    ShellCommand,
    StorageConfig,
    VerificationConfig,
)
from rfpipe.config.mistakes import ABOUT_SETTING, mistake, mistake_error, relocated
from rfpipe.config.scenes import SceneSettings
from rfpipe.provenance import fingerprint
from rfpipe.units import NormalizationMode

_RESERVED_FOLDERS = {"catalogue", "report", "verified"}
"""Folders in a run's results that don't belong to a scene."""

TARGET_MARGIN = 1.5
"""Largest ratio of a measured error to the target error at which the target counts as met.

Where a method stopped at its target by its own estimate, the errors of 96 pictures were at most 1.2
times the target on the benchmark's tuning scenes; the mean of nine pictures scatters more.
"""

SMALL_RAYS = 4000
"""Largest number of rays at which an acquisition is one job by default.

Each stage reads the method's state and prepares the simulated scene again: four scenes of 16 x 18
rays by `near_far` took 47 s of processor time as 84 jobs, 27 s as 15. A capture of 96 x 108 rays of
the coloured room computes its form factors in 4 s, beside a refinement of 40 s.
"""

DEFAULT_METHODS = ("near_far", "symmetric", "dual")
"""Methods of a run that names none, in the order of its report."""

_RUN_ONLY = {"capture": ("rig",), "resources": ("jobs", "captures"), "storage": ("keep_at",)}
"""Options that no scene can override, in groups that a scene can override."""

_WITHOUT_EFFECT_ON_RESULTS = {
    *("batch_patterns", "keep_raw", "when_patterns_change"),
    *("url", "token_file", "patience_seconds", "placing"),
}
"""Settings of the group ``capture`` that neither change a result nor describe one."""


def _allow_collection(schema: dict[str, Any]) -> None:
    """State in a JSON schema that a collection may take the place of scenes."""
    schema["anyOf"] = [{"required": [name]} for name in ("scenes", "collection")]
    del schema["required"]


class Config(Settings):
    """All settings of a run."""

    model_config = ConfigDict(json_schema_extra=_allow_collection)

    seed: int = Field(1, description="Seed of the simulated noise.", ge=0)
    scenes: dict[SectionName, SerializeAsAny[SceneSettings]] = Field(
        min_length=1,
        description="The scenes by name; a name consists of lower-case letters, digits and _.",
    )
    collection: Text | None = Field(
        None,
        description="CSV file with further scenes, one per row (docs/collections.md); null: none.",
    )
    rigs: dict[SectionName, dict[str, Any]] = Field(
        {},
        description="Settings that the scenes of one rig share, as in {studio: {camera: {bits: "
        "14}}}.",
    )
    methods: MethodSections = Field(
        default_factory=lambda: dict.fromkeys(DEFAULT_METHODS),
        validate_default=True,
        description="Methods that acquire each scene, with their options, as in {symmetric: {}}.",
    )
    camera: CameraConfig | None = Field(
        default_factory=CameraConfig,
        description="Camera of a simulated or offline rig; null: exact radiance.",
    )
    capture: CaptureConfig = group_of(CaptureConfig)
    merge: MergeConfig = group_of(MergeConfig)
    normalization: NormalizationMode = Field(
        "per_channel",
        description="Scaling of a level to the floodlit image [B.2]: per_channel, total_energy "
        "(as in the thesis) or none.",
    )
    verification: VerificationConfig = group_of(VerificationConfig)
    offline: OfflineConfig = group_of(OfflineConfig)
    rig_file: Text | None = Field(
        None, description="Settings file of the rig for 'rfpipe run calibrate'; null: none."
    )
    storage: StorageConfig = group_of(StorageConfig)
    resources: ResourcesConfig = group_of(ResourcesConfig)
    notify: ShellCommand | None = Field(
        None,
        description="Command at the end of a run, with the environment variables RFPIPE_STATUS "
        "(done, failed) and RFPIPE_LOG; null: none.",
    )
    report: ReportConfig = group_of(ReportConfig)

    def methods_of(self, scene: str) -> dict[str, MethodSettings]:
        """Return the methods of a scene with their options: those of the scene or of the run."""
        return self.scenes[scene].methods or self.methods

    @cached_property
    def _without_scenes(self) -> dict[str, Any]:
        """All settings except the scenes, as a base for overrides."""
        return self.model_dump(exclude={"scenes", "collection", "rigs"})

    @cached_property
    def _checked_overrides(self) -> dict[str, Config]:
        """Cache of overridden settings by the fingerprint of the overrides."""
        return {}

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return a copy without the values that are cached from these settings."""
        copied = super().model_copy(update=update, deep=deep)
        for derived in ("_without_scenes", "_checked_overrides", "acquisitions", "jobs_and_reason"):
            copied.__dict__.pop(derived, None)
        return copied

    def of_scene(self, scene: str) -> Config:
        """Return the settings of one scene: the run's, overridden by its rig's and its own.

        Raises
        ------
        ValidationError
            When the overrides are wrong.
        """
        section = self.scenes[scene]
        rig = self.rigs[section.rig] if section.rig else {}
        if not rig and not section.settings:
            return self
        overrides = merge_settings(rig, section.settings)
        # scenes with equal overrides share the validation
        key, cache = fingerprint(overrides), self._checked_overrides
        if key not in cache:
            cache[key] = self._overridden(scene, overrides)
        return cache[key].model_copy(update={"scenes": {scene: section}})

    def _overridden(self, scene: str, overrides: Mapping[str, Any]) -> Config:
        """Return the settings of one scene with overrides of the run's settings."""
        names = ", ".join(sorted(OWN_TO_SCENES))
        problems = [
            mistake(f"can't be set for a scene; expected settings among {names}", name)
            for name in overrides
            if name not in OWN_TO_SCENES
        ] + [
            mistake("can't be set for a scene: it applies to the whole run", group, option)
            for group, options in _RUN_ONLY.items()
            for option in options
            if isinstance(overrides.get(group), Mapping) and option in overrides[group]
        ]
        if problems:
            raise ValidationError.from_exception_data("settings", problems)
        plain_scene = self.scenes[scene].model_copy(update={"settings": {}, "rig": None})
        base = {**self._without_scenes, "scenes": {scene: plain_scene}}
        return Config.model_validate(merge_settings(base, overrides))

    @property
    def verification_pictures(self) -> int:
        """Number of verification pictures of each acquisition, 0 for none."""
        count = self.verification.pictures
        return self.capture.precautions.verification_pictures if count is None else count

    @property
    def divides_out_drift(self) -> bool:
        """True if images are divided by the lamp's brightness."""
        divides = self.merge.divide_out_drift
        return self.capture.precautions.divide_out_drift if divides is None else divides

    def bound_of(self, scene: str, method: str) -> float | None:
        """Return the mean error above which an acquisition fails the run; None for no limit.

        The error is that of the verification pictures, or without these the method's estimate.
        """
        of_scene = self.of_scene(scene)
        bound = of_scene.verification.fail_above
        if bound is not None or self.capture.rig == "simulated":
            return bound
        target = self.methods_of(scene)[method].error_target
        margin = TARGET_MARGIN if of_scene.verification_pictures else 1.0
        return None if target is None else margin * float(target)

    @property
    def title(self) -> str:
        """Title of the report."""
        count = len(self.scenes)
        scenes = f"{count} scenes" if count > 1 else next(iter(self.scenes))
        return self.report.title or f"Light transport of {scenes}"

    @property
    def has_report(self) -> bool:
        """True if the run ends with a report."""
        page = self.report.page
        return self.collection is None if page is None else page

    @property
    def jobs(self) -> Literal["stage", "acquisition"]:
        """Work of one job of the workflow: a stage or an acquisition."""
        return self.jobs_and_reason[0]

    @cached_property
    def jobs_and_reason(self) -> tuple[Literal["stage", "acquisition"], str]:
        """Work of one job, and the reason as a clause for messages; no result depends on it."""
        if self.resources.jobs is not None:
            return self.resources.jobs, "as set by resources.jobs"
        if self.collection:
            return "acquisition", "as in every collection"
        if any(self.of_scene(scene).capture.placing for scene in self.scenes):
            return "acquisition", "since scenes are placed one after the other (capture.placing)"
        if self.capture.rig == "offline":
            return "stage", "since its pictures are taken elsewhere, level by level"
        rays = max(prod(scene.ray_shape) for scene in self.scenes.values())
        if rays <= SMALL_RAYS:
            return "acquisition", (
                f"since no scene has more than {SMALL_RAYS:,} rays, and a job a stage would "
                "take longer"
            )
        return "stage", f"since a scene has {rays:,} rays"

    def result_settings(self) -> dict[str, Any]:
        """Return the settings that influence or describe results, as plain data."""
        return self.model_dump(
            mode="json",
            exclude={
                "resources": True,
                "notify": True,
                "rig_file": True,
                "collection": True,
                "scenes": {"__all__": {"about"}},
                "capture": _WITHOUT_EFFECT_ON_RESULTS,
                "storage": {"keep_at"},
            },
        )

    @cached_property
    def acquisitions(self) -> list[tuple[str, str]]:
        """Scene and method of each acquisition."""
        return [(scene, method) for scene in self.scenes for method in self.methods_of(scene)]

    @model_validator(mode="before")
    @classmethod
    def _merge_method_options(cls, settings: Any) -> Any:
        """Merge the options of a scene's methods into those of the run's methods."""
        if not isinstance(settings, Mapping):
            return settings
        if settings.get("collection") and "scenes" not in settings:
            raise ValueError("collection is only read by load_config and parse_config")
        scenes, run = settings.get("scenes"), settings.get("methods")
        if not isinstance(scenes, Mapping) or not isinstance(run, Mapping):
            return settings
        filled = dict(scenes)
        for name, scene in scenes.items():
            methods = scene.get("methods") if isinstance(scene, Mapping) else None
            if isinstance(methods, Mapping):
                base = {method: run.get(method) or {} for method in methods}
                options = {method: {} if it is None else it for method, it in methods.items()}
                filled[name] = {**scene, "methods": merge_settings(base, options)}
        return {**settings, "scenes": filled}

    @model_validator(mode="after")
    def _check_folders_and_rigs(self) -> Self:
        acquisition_of_page: dict[str, tuple[str, str]] = {}
        for scene, method in self.acquisitions:
            page = f"{scene}_{method}"
            first = acquisition_of_page.setdefault(page, (scene, method))
            rig = self.scenes[scene].rig
            for section, name in (("scenes", scene), ("methods", method)):
                if re.fullmatch(RESERVED_ON_WINDOWS, name):
                    raise mistake_error(
                        "no folder can have this name on Windows, to which results may be copied; "
                        "choose another name",
                        section,
                        name,
                    )
            if scene in _RESERVED_FOLDERS:
                raise mistake_error(
                    f"this name is reserved, since rfpipe writes other files to results/{scene}; "
                    "rename the scene",
                    "scenes",
                    scene,
                )
            if first != (scene, method):
                raise mistake_error(
                    f"by {method} it has the same page, {page}, as scenes.{first[0]} by "
                    f"{first[1]}; rename one of the scenes or methods",
                    "scenes",
                    scene,
                )
            if rig is not None and rig not in self.rigs:
                raise mistake_error(
                    f"is {rig!r}; the section rigs has {', '.join(self.rigs) or 'no entries'}. "
                    "Add it there, or remove this setting",
                    *("scenes", scene, "rig"),
                    kind=ABOUT_SETTING,
                )
        return self

    @model_validator(mode="after")
    def _check_overrides(self) -> Self:
        first = next(iter(self.scenes))
        rigs = {
            ("rigs", name): partial(self._overridden, first, rig) for name, rig in self.rigs.items()
        }
        scenes = {
            ("scenes", name, "settings"): partial(self.of_scene, name)
            for name, scene in self.scenes.items()
            if scene.rig or scene.settings
        }
        for checks in (rigs, scenes):  # the mistakes of a rig aren't repeated for its scenes
            problems = []
            for location, check in checks.items():
                try:
                    check()
                except ValidationError as error:
                    fields = Config.model_fields
                    problems += [relocated(it, fields, *location) for it in error.errors()]
            if problems:
                raise ValidationError.from_exception_data("settings", problems)
        return self

    @model_validator(mode="after")
    def _check_scenes_fit_the_rig(self) -> Self:
        self._check_number_of_scenes()
        for name, scene in self.scenes.items():
            if scene.is_captured and self.capture.rig == "simulated":
                raise mistake_error(
                    "capture.rig should be remote or offline for a real scene; it is simulated",
                    "scenes",
                    name,
                )
            for method, section in self.methods_of(name).items():
                if section.plugin.needs_coaxial_rig and not scene.is_coaxial:
                    raise mistake_error(
                        f"{method} needs a coaxial rig, whose camera and projector share their "
                        "rays; choose methods for any rig, such as {dual: {}}",
                        *("scenes", name, "methods"),
                    )
            camera = self.of_scene(name).camera
            bayer = None if camera is None else camera.bayer
            if bayer is not None and scene.channels != 3 and not scene.is_captured:
                raise mistake_error(
                    f"is {scene.channels}; set it to 3, or camera.bayer, which is {bayer}, to null",
                    *("scenes", name, "channels"),
                    kind=ABOUT_SETTING,
                )
        return self

    def _check_number_of_scenes(self) -> None:
        """Raise ValueError for several scenes in front of a rig, unless a command places them."""
        kind, count = self.capture.rig, len(self.scenes)
        placed = sum(bool(self.of_scene(name).capture.placing) for name in self.scenes)
        if count == 1 or kind == "simulated" or (kind == "remote" and placed >= count - 1):
            return
        raise ValueError(
            f"scenes should contain one scene with capture.rig {kind}, not {count}: a rig captures "
            "one at a time. Write a settings file for each scene, or, for a remote rig, set "
            "capture.placing, a command that puts each scene in its place"
        )

    @model_validator(mode="after")
    def _check_verification(self) -> Self:
        if self.verification.fail_above is not None and not self.verification_pictures:
            raise ValueError(
                "verification.pictures should be 1 to 96 with verification.fail_above; this run "
                "takes none"
            )
        return self


OWN_TO_SCENES = frozenset(Config.model_fields) - {
    *("collection", "methods", "notify", "report", "rig_file", "rigs", "scenes")
}
"""Groups of a run's settings that a scene can override."""
