"""What the stages of one acquisition follow: its method's state, and their part of the settings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.methods import Method, Pack, get_method, options_of
from rfpipe.methods.states import unprefixed
from rfpipe.plugins import METHODS, SCENES, is_of_rfpipe, sources_of
from rfpipe.provenance import code_digest, source_digest
from rfpipe.references.symmetry import choose_method, read_asymmetry
from rfpipe.rigs.calibrated import was_coaxial
from rfpipe.storage.files import AcquisitionFolder
from rfpipe.units import SYMMETRY_FRAMES

if TYPE_CHECKING:
    from rfpipe.config import Config, SceneSettings


class Plan:
    """What an acquisition's stages know of it: its method, with its options, and its rays.

    Parameters
    ----------
    name : str
        What the settings' section and the results' folder are called.
    method : str or Method
        See `rfpipe.methods.get_method`.
    camera_shape, projector_shape : sequence of int
        See `rfpipe.blocks.RayDomain`.
    channels : int
        Colour channels, 1 or 3.
    options : mapping
        The method's; InputError where it lacks one.
    asymmetry : float
        Error in relit pictures, relative to their norm, that taking the rig for a coaxial one may
        make.
    """

    def __init__(
        self, name: str, method: str | Method[Any],
        camera_shape: Sequence[int], projector_shape: Sequence[int], channels: int,
        options: Mapping[str, Any] | None = None, asymmetry: float = 0.05,
    ) -> None:  # fmt: skip
        self.name = name
        named = get_method(method)
        self.camera = RayDomain(tuple(camera_shape))
        self.projector = RayDomain(tuple(projector_shape))
        self.channels = channels
        self.options = options_of(named, **(options or {}))
        self.asymmetry = asymmetry
        self.named: Method[Any] = named
        self.method: Method[Any] = named
        self._carried: tuple[int | None, Any] | None = None
        self._restored: tuple[list[str], Any] | None = None

    @property
    def n_levels(self) -> int:
        """Number of levels; raises InputError where the method doesn't fit the rays."""
        return self.method.n_levels(self.camera, self.projector)

    @property
    def asks_symmetry(self) -> bool:
        """Whether it has to be known if the rig is coaxial."""
        return self.method.asks_symmetry(self.camera, self.projector)

    def settle(self, folder: AcquisitionFolder, *, aloud: bool = False) -> None:
        """Go on, after level 0's pictures, by the method that suits the rig, and `aloud` log why.

        Raises CaptureError when the method needs a coaxial rig, and this is none.
        """
        measured = read_asymmetry(folder)
        if measured is not None:
            calibrated = was_coaxial(folder.read_manifest(0, "capture")["rig"])
            named = choose_method(
                measured, self.named, self.options, self.asymmetry,
                log=aloud, was_coaxial=calibrated,
            )  # fmt: skip
        else:
            is_coaxial = self.camera.shape == self.projector.shape
            named = self.named if is_coaxial else self.named.on_rig(coaxial=False)
        if type(named) is not type(self.method):
            self._carried = self._restored = None
        self.method = named

    def carry(self, level: int | None, state: Any) -> None:
        """Keep the method's state before a level for `state_before`; None: after the last one."""
        self._carried, self._restored = (level, state), None

    def end_early(self) -> bool:
        """Take the state that is carried for the last one; tell whether there is any."""
        if self._carried:
            self.carry(None, self._carried[1])
        return self._carried is not None

    def state_before(self, folder: AcquisitionFolder, level: int | None) -> Any:
        """Return the method's state before a level; None for that after the last one.

        It is carried from the level above, or restored once from what all levels left, of which
        only its own parts are read. Errors are those of `AcquisitionFolder.open`.
        """
        if self._carried and self._carried[0] == level:
            return self._carried[1]
        refined = [str(folder.path), *folder.refined_above(level)]
        if self._restored is None or self._restored[0] != refined:
            packs = [pack for above in folder.levels_above(level) for pack in _packs(folder, above)]
            start = self.method.start(self.camera, self.projector, self.channels, self.options)
            self._restored = refined, self.method.restore(start, packs)
        return self._restored[1]

    def describe(self, method: Method[Any] | None = None) -> dict[str, Any]:
        """Plain data for fingerprints, of the settled method if no other one is given."""
        return {
            "name": self.name,
            "method": (method or self.method).name,
            "camera_shape": list(self.camera.shape),
            "projector_shape": list(self.projector.shape),
            "channels": self.channels,
            "options": self.options.options(),
        }


def packed(packs: Sequence[Pack]) -> tuple[dict[str, NDArray[Any]], list[dict[str, Any]]]:
    """Return arrays and plain data of a level's pack, and of those without patterns behind it."""
    arrays = {
        f"{number}_{name}" if number else name: array
        for number, pack in enumerate(packs)
        for name, array in pack.arrays.items()
    }
    return arrays, [dict(pack.attributes) for pack in packs]


def _packs(folder: AcquisitionFolder, level: int) -> list[Pack]:
    """Undo `packed`."""
    arrays, attributes = folder.open(level, "refine")
    states = attributes["states"]
    behind = [unprefixed(f"{number}_", arrays) for number in range(1, len(states))]
    return [Pack(*held) for held in zip([arrays, *behind], states, strict=True)]


def plan_of(settings: Config, scene: str, name: str) -> dict[str, Any]:
    """Return the arguments of one of a run's plans as plain data."""
    section = settings.methods_of(scene)[name]
    return {
        "name": name,
        "method": section.method or name,
        **_rays(settings.scenes[scene]),
        "options": section.options(),
        "asymmetry": settings.of_scene(scene).capture.asymmetry,
    }


def _rays(scene: SceneSettings) -> dict[str, Any]:
    shapes = {"camera_shape": scene.camera_ray_shape, "projector_shape": scene.ray_shape}
    return {**{name: list(shape) for name, shape in shapes.items()}, "channels": scene.channels}


MANNER = (
    "batch_patterns",
    "warm_up_minutes",
    "when_patterns_change",
    "watch",
    "asymmetry",
    "keep_raw",
)
"""Settings of a capture that shape no result: a change of them runs nothing again."""


def manner_of(config: Config, scene: str) -> dict[str, str]:
    """Return the settings `MANNER` of a scene as text, as the resources of a job have them."""
    capture = config.of_scene(scene).capture
    manner = {name: str(getattr(capture, name)) for name in MANNER}
    return {**manner, "watch": "off" if capture.rig == "simulated" else capture.watch}


def in_manner(
    stages: Mapping[str, Mapping[str, Any]], manner: Mapping[str, str]
) -> dict[str, dict[str, Any]]:
    """Add the settings of `manner_of` to the keyword arguments of stages, see `stages_of`."""
    settings = {stage: dict(of_stage) for stage, of_stage in stages.items()}
    if "capture" in settings:
        capture = settings["capture"]
        capture["batch_patterns"] = int(manner["batch_patterns"])
        capture["warm_up_minutes"] = float(manner["warm_up_minutes"])
        capture["when_patterns_change"] = manner["when_patterns_change"]
        capture["watching"] = {
            **capture["watching"],
            "mode": manner["watch"],
            "asymmetry": float(manner["asymmetry"]),
        }
    if "merge" in settings:
        settings["merge"]["keep_raw"] = manner["keep_raw"] == "True"
    return settings


def stages_of(config: Config, scene: str, name: str) -> dict[str, dict[str, Any]]:
    """Return the keyword arguments of each stage that shape its result, the same before any rig.

    Among them is the digest of the code, except of captures: an edit takes no picture again. The
    other arguments are added by `in_manner`.
    """
    plan = Plan(**plan_of(config, scene, name))
    code = {"code": code_of(config, scene, name)}
    of_scene = config.of_scene(scene)
    capture = of_scene.capture
    captured = {
        "references": [capture.black_frames, capture.floodlit_frames],
        "symmetry_frames": SYMMETRY_FRAMES if plan.asks_symmetry else 0,
        "watching": {"check_interval": capture.precautions.check_interval},
    }
    merged = {
        "mask_defects": of_scene.merge.mask_defects,
        "divide_out_drift": of_scene.divides_out_drift,
    }
    sources = user_sources(config, scene, name)
    return {
        "schedule": code,
        "capture": captured,
        "merge": {**merged, **code},
        "normalize": {"mode": of_scene.normalization, **code},
        "refine": code,
        "assemble": {
            "scene": scene,
            "number_format": of_scene.storage.number_format,
            **({"sources": sources} if sources else {}),
            **code,
        },
    }


def code_of(config: Config, scene: str, name: str | None = None, *, pages: bool = False) -> str:
    """Return the digest of the code behind an acquisition's results; see `code_digest`.

    The files of a scene and a method of a user's own count, too.
    """
    used = _classes(config, scene, name).values()
    return code_digest(*(path for each in used for path in sources_of(*each)), pages=pages)


def user_sources(config: Config, scene: str, name: str) -> dict[str, str]:
    """Digests of the files of a user's scene and method, by ``scene`` and ``method``.

    Classes of rfpipe and its extras have no entry.
    """
    return {
        role: source_digest(*sources_of(*named))
        for role, named in _classes(config, scene, name).items()
        if not is_of_rfpipe(*named)
    }


def _classes(config: Config, scene: str, name: str | None) -> dict[str, tuple[str, str]]:
    """Groups and names of the classes of a scene and its method; see `rfpipe.plugins`."""
    classes = {"scene": (SCENES, config.scenes[scene].kind)}
    if name is not None:
        classes["method"] = (METHODS, config.methods_of(scene)[name].method or name)
    return classes


def rig_of(config: Config, scene: str) -> dict[str, Any]:
    """Return what the capture stage's rig is made of; see `rfpipe.stages.captures`."""
    about, of_scene = config.scenes[scene], config.of_scene(scene)
    camera = {"camera": of_scene.camera and of_scene.camera.model_dump(mode="json")}
    if config.capture.rig == "remote":
        return {"by": "server", "rig": _rays(about)}
    if config.capture.rig == "offline":
        offline = of_scene.offline.model_dump(mode="json")
        return {"by": "pictures", "rig": {"offline": offline, **camera, **_rays(about)}}
    rig = {"scene": about.scene_options(), **camera, "seed": of_scene.seed}
    return {"by": "simulation", "rig": rig}
