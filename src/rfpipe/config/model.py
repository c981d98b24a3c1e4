"""The model of a run's settings: names, units, ranges and defaults.

Plain data only: the layers above build cameras, scenes and methods from it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property, partial
from typing import Any, Literal, Self

from pydantic import (
    ConfigDict,
    Field,
    SerializeAsAny,
    ValidationError,
    field_validator,
    model_validator,
)
from pydantic_core import InitErrorDetails, PydanticCustomError

from rfpipe.config.base import (
    MethodSections,
    MethodSettings,
    SectionName,
    Settings,
    Text,
    check_command,
    group_of,
)
from rfpipe.config.camera import CameraConfig
from rfpipe.config.capture import CaptureConfig, OfflineConfig, VerificationConfig
from rfpipe.config.own import check_own, merged
from rfpipe.config.processing import (
    MergeConfig,
    Normalization,
    ReportConfig,
    ResourcesConfig,
    StorageConfig,
)
from rfpipe.config.scenes import SceneSettings
from rfpipe.provenance import fingerprint

# Folders of a run's results that are no scene's.
_OTHER_FOLDERS = {"catalogue", "references", "report", "verified"}

# That verify what a real rig acquires.
_VERIFICATION_PICTURES = 8

# Those of a run that names none, in the order of its report.
DEFAULT_METHODS = ("near_far", "symmetric", "dual")


def _scenes_or_a_collection(schema: dict[str, Any]) -> None:
    """Say in a JSON schema that scenes may stand in a collection, which is read before."""
    schema["anyOf"] = [{"required": [name]} for name in ("scenes", "collection")]
    del schema["required"]


class Config(Settings):
    """All settings of a run."""

    model_config = ConfigDict(json_schema_extra=_scenes_or_a_collection)

    seed: int = Field(1, ge=0, description="Seed of the captures' noise, an integer of at least 0.")
    scenes: dict[SectionName, SerializeAsAny[SceneSettings]] = Field(
        min_length=1,
        description="The scenes by name: lower-case letters, digits and _.",
    )
    collection: Text | None = Field(
        None,
        description="A CSV or YAML file whose rows are scenes, too (docs/collections.md); or null.",
    )
    rigs: dict[SectionName, dict[str, Any]] = Field(
        default_factory=dict,
        description="Settings that the scenes before one rig share, such as {studio: {camera: "
        "{bits: 14}}}.",
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
    normalization: Normalization = Field(
        "per_channel",
        description="Scaling of a level's images to the floodlit image [B.2]: none, per_channel, "
        "or total_energy (the thesis' own, for colour mosaics).",
    )
    verification: VerificationConfig = group_of(VerificationConfig)
    offline: OfflineConfig = group_of(OfflineConfig)
    rig_file: Text | None = Field(
        None,
        description="Settings of the rig that 'snakemake calibrate' calibrates, or null.",
    )
    storage: StorageConfig = group_of(StorageConfig)
    resources: ResourcesConfig = group_of(ResourcesConfig)
    notify: Text | None = Field(
        None,
        description="Command for the end of a run, which finds RFPIPE_STATUS (done or failed) and "
        "RFPIPE_LOG in its environment; or null.",
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
        for name, derived in vars(Config).items():
            if isinstance(derived, cached_property):
                copied.__dict__.pop(name, None)
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
        own = merged(rig, about.settings)
        # scenes that share these settings share what is checked of them
        key, known = fingerprint(own), self._by_overrides
        if key not in known:
            known[key] = self._with(scene, own)
        return known[key].model_copy(update={"scenes": {scene: about}})

    def _with(self, scene: str, own: Mapping[str, Any]) -> Config:
        """Return settings of one scene, with others put over those of the run."""
        check_own(own)
        alone = self.scenes[scene].model_copy(update={"settings": {}, "rig": None})
        return Config.model_validate(merged({**self._base, "scenes": {scene: alone}}, own))

    @property
    def verification_pictures(self) -> int:
        """Pictures that verify each acquisition, 0 for none."""
        asked = self.verification.pictures
        return _VERIFICATION_PICTURES * (self.capture.rig == "remote") if asked is None else asked

    @property
    def title(self) -> str:
        """The report's title."""
        many = len(self.scenes)
        of = f"{many} scenes" if many > 1 else next(iter(self.scenes))
        return self.report.title or f"Light transport of {of}"

    @property
    def has_report(self) -> bool:
        """Whether the run ends with a report."""
        asked = self.report.page
        return self.collection is None if asked is None else asked

    @property
    def jobs(self) -> Literal["stage", "acquisition"]:
        """What a job of the workflow is."""
        placed = any(self.of_scene(scene).capture.placing for scene in self.scenes)
        return self.resources.jobs or ("acquisition" if self.collection or placed else "stage")

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
                "capture": {"keep_raw", "url", "token_file", "patience_seconds", "placing"},
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
        if not isinstance(settings, Mapping) or not isinstance(settings.get("scenes"), Mapping):
            return settings
        run = settings.get("methods")
        sections = run if isinstance(run, Mapping) else {}
        scenes = {
            name: {**scene, "methods": _over(sections, scene["methods"])}
            if isinstance(scene, Mapping) and isinstance(scene.get("methods"), Mapping)
            else scene
            for name, scene in settings["scenes"].items()
        }
        return {**settings, "scenes": scenes}

    @field_validator("notify")
    @classmethod
    def _notify_is_a_command(cls, command: str | None) -> str | None:
        return check_command(command)

    @model_validator(mode="before")
    @classmethod
    def _collection_is_read(cls, settings: object) -> object:
        given = settings if isinstance(settings, Mapping) else {}
        if given.get("collection") and "scenes" not in given:
            raise ValueError("collection is read by load_config and parse_config alone")
        return settings

    @model_validator(mode="after")
    def _scenes_have_folders(self) -> Self:
        for name in self.scenes:
            if name in _OTHER_FOLDERS:
                raise ValueError(
                    f"scenes.{name} should be called otherwise: results/{name} is the folder of "
                    "something else"
                )
        first: dict[str, tuple[str, str]] = {}
        for scene, method in self.acquisitions:
            page = f"{scene}_{method}"
            other, by = first.setdefault(page, (scene, method))
            if other != scene:
                raise ValueError(
                    f"scenes.{scene} should be called otherwise, or its method: by {method} its "
                    f"page would be {page}, as that of {other} by {by} is"
                )
        return self

    @model_validator(mode="after")
    def _scenes_have_rigs(self) -> Self:
        for name, scene in self.scenes.items():
            if scene.rig is not None and scene.rig not in self.rigs:
                known = ", ".join(self.rigs) or "none"
                raise ValueError(
                    f"scenes.{name}.rig is {scene.rig!r}; the settings' rigs are: {known}. Add it "
                    "to rigs, or leave it out"
                )
        return self

    @model_validator(mode="after")
    def _own_settings_are_settings(self) -> Self:
        if not self.rigs and not any(scene.settings for scene in self.scenes.values()):
            return self
        first = next(iter(self.scenes))
        _check_each(
            {("rigs", name): partial(self._with, first, rig) for name, rig in self.rigs.items()}
        )
        _check_each(
            {("scenes", name, "settings"): partial(self.of_scene, name) for name in self.scenes}
        )
        return self

    @model_validator(mode="after")
    def _rig_fits_the_scenes(self) -> Self:
        captured = [name for name, scene in self.scenes.items() if scene.is_captured]
        if captured and self.capture.rig == "simulated":
            raise ValueError(
                f"capture.rig should be remote or offline for scenes.{captured[0]}, which is a "
                "real scene, not a simulated one"
            )
        if self.capture.rig != "simulated" and len(self.scenes) > 1:
            unplaced = [name for name in self.scenes if not self.of_scene(name).capture.placing]
            if self.capture.rig == "offline" or len(unplaced) > 1:
                placed = " or set capture.placing, a command that puts each in its place"
                raise ValueError(
                    f"scenes should be one with capture.rig {self.capture.rig}, not "
                    f"{', '.join([*self.scenes][:5])}{' ...' * (len(self.scenes) > 5)}: a rig sees "
                    "one at a time; give each settings of its own"
                    f"{placed * (self.capture.rig == 'remote')}"
                )
        for name, method in self.acquisitions:
            scene = self.scenes[name]
            about = self.methods_of(name)[method].subject
            if about.needs_coaxial_rig and not scene.is_coaxial:
                raise ValueError(
                    f"scenes.{name}.methods should be methods for any rig, such as {{dual: {{}}}}: "
                    f"{method} needs a coaxial one, whose camera and projector share their rays"
                )
        return self

    @model_validator(mode="after")
    def _verification_has_pictures(self) -> Self:
        if self.verification.fail_above is not None and not self.verification_pictures:
            raise ValueError(
                "verification.pictures should be 1 to 10 with verification.fail_above; this run "
                "takes none"
            )
        return self

    @model_validator(mode="after")
    def _pictures_can_be_taken_elsewhere(self) -> Self:
        if self.capture.rig != "offline":
            return self
        if self.capture.drift_minutes is not None:
            raise ValueError(
                "capture.drift_minutes should be null with capture.rig offline, whose pictures say "
                "nothing of their time"
            )
        if self.verification.pictures:
            raise ValueError(
                "verification.pictures should be 0 or null with capture.rig offline, whose "
                "pictures are taken level by level by hand"
            )
        if self.offline.camera_corners is not None and self.camera is None:
            raise ValueError(
                "camera should be set with offline.camera_corners, not null: exact radiance isn't "
                "resampled"
            )
        return self

    @model_validator(mode="after")
    def _mosaic_has_colour(self) -> Self:
        for name, scene in self.scenes.items():
            camera = self.of_scene(name).camera
            bayer = None if camera is None else camera.bayer
            if bayer is not None and scene.channels != 3 and not scene.is_captured:
                raise ValueError(
                    f"camera.bayer {bayer} needs scenes of 3 channels, but "
                    f"scenes.{name}.channels is {scene.channels}; set it to 3, or bayer to null"
                )
        return self


def _over(sections: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    """Return a scene's methods with the options that it leaves out as the run has them."""
    found = {}
    for name, options in own.items():
        run = sections.get(name) or {}
        if isinstance(run, MethodSettings):
            run = run.model_dump(exclude_unset=True)
        is_group = isinstance(run, Mapping) and (options is None or isinstance(options, Mapping))
        found[name] = {**run, **(options or {})} if is_group else options
    return found


def _check_each(checks: Mapping[tuple[str, ...], Callable[[], object]]) -> None:
    """Check settings at several places; raise ValidationError with all mistakes."""
    problems: list[InitErrorDetails] = []
    for place, check in checks.items():
        try:
            check()
        except ValidationError as error:
            problems += [_placed(problem, place) for problem in error.errors(include_url=False)]
    if problems:
        raise ValidationError.from_exception_data("settings", problems)


def _placed(problem: Any, place: tuple[str, ...]) -> InitErrorDetails:
    """Return one of pydantic's problems as one of the settings at a place."""
    kind, location = problem["type"], (*place, *problem["loc"])
    if kind in ("unknown_name", "value_error"):
        text = problem["msg"].removeprefix("Value error, ")
        kind = PydanticCustomError(kind, "{message}", {"message": text})
    context = problem.get("ctx", {})
    return InitErrorDetails(type=kind, loc=location, input=problem["input"], ctx=context)
