# What the rules share: the checked settings, and functions that give each rule its part of them.

from functools import cache

import rfpipe
from snakemake.logging import logger
from rfpipe.config import load_config, parse_config, read_yaml
from rfpipe.costs import JobCosts, machine_memory_mb
from rfpipe.errors import ConfigError, RfpipeError
from rfpipe.methods import method_names
from rfpipe.plugins import METHODS, SCENES
from rfpipe.provenance import fingerprint
from rfpipe.stages.acquisitions import mark_outdated
from rfpipe.stages.evaluating.studies import FIGURES
from rfpipe.stages.evaluating.sweep import is_swept
from rfpipe.stages.folder import AcquisitionFolder
from rfpipe.stages.jobs.code import module_of, stage_code
from rfpipe.stages.jobs.failures import FailedJobs
from rfpipe.stages.jobs.groups import check_groups
from rfpipe.stages.jobs.notify import notify
from rfpipe.stages.jobs.settings import simulation_of, stages_of, verification_of
from rfpipe.stages.levels import level_after, level_before
from rfpipe.stages.plan import plan_of
from rfpipe.stages.verifying.again import write_run
from rfpipe.store.files import digest_of

for configfile in workflow.configfiles:
    read_yaml(configfile)  # finds what Snakemake reads otherwise than it was meant
if len(workflow.configfiles) == 1:
    load_config(workflow.configfiles[0])  # finds keys that stand twice, too
SETTINGS = parse_config(
    config, "the configuration", [Path(file).parent for file in workflow.configfiles]
)

if workflow.storage_settings.default_storage_provider:
    raise ConfigError(
        "--default-storage-provider: Snakemake would bring the manifests of captures and results "
        "into a bucket, and leave their stores behind; set storage.keep_at in place of it "
        "(docs/stores.md)"
    )


if workflow.is_main_process:
    # Snakemake knows what its own jobs were asked for; of others their manifests tell
    mark_outdated(SETTINGS, Path("results"))


wildcard_constraints:
    scene="|".join(SETTINGS.scenes),
    method="|".join(sorted({method for _, method in SETTINGS.acquisitions})),
    level=r"\d+",


def plain(settings):
    """Settings as plain data, which is all that a rule's params should hold."""
    return settings.model_dump(mode="json")


# All settings but those that shape no result: changing these does nothing anew.
SHAPING = SETTINGS.shaping()

# What the viewer's pages run, which is no Python.
VIEWER_WEB = fingerprint(
    [
        digest_of(path.read_bytes())
        for path in sorted((Path(rfpipe.__file__).parent / "viewer").glob("*/*.*"))
    ]
)

# Minutes of jobs of which nothing is known: of the studies, and of the report on many scenes.
LONG_MINUTES = 240
COSTS = JobCosts(SETTINGS, Path("results"))

# Jobs that run side by side on this machine share its memory; --resources mem_mb=... says less. By
# what they run isn't known yet, but jobs of a cluster have a number of nodes.
if (
    workflow.nodes is None
    and not workflow.remote_exec
    and "mem_mb" not in workflow.global_resources
):
    workflow.register_resource("mem_mb", machine_memory_mb())


def asked(job, of_level=False):
    """Resources that a job of an acquisition asks for: as predicted, more after a failure.

    A job of one level asks for what other scenes' jobs of that level took, once there are any.
    """

    def of(predict):
        def found(wildcards, attempt):
            level = int(wildcards.level) if of_level else None
            return predict(job, wildcards.scene, wildcards.method, attempt, level=level)

        return found

    found = {"mem_mb": of(COSTS.memory_mb), "runtime": of(COSTS.runtime)}
    if job == "acquire":
        found["disk_mb"] = lambda wildcards: COSTS.disk_mb(
            wildcards.scene, wildcards.method
        )
    return found


def asked_by_run(name):
    """Memory that a job of the whole run asks for: as it took before, by its log."""
    return {
        "mem_mb": lambda wildcards, attempt: COSTS.memory_of_log(
            Path(name.format(wildcards=wildcards)), attempt
        )
    }


@cache
def of_scene(scene):
    """The settings that hold for a scene."""
    return SETTINGS.of_scene(scene)


@cache
def simulation(scene):
    """What the simulated rig before a scene is made of."""
    return simulation_of(SETTINGS, scene)


# What an acquisition works within, and where: resources, since it shapes no result.
WITHIN = {
    "memory_gib": lambda wildcards: str(of_scene(wildcards.scene).resources.memory_gib),
    "workers": lambda wildcards: of_scene(wildcards.scene).resources.workers,
}


def all_cores(wildcards):
    """The cores of this machine that a job may have; on a cluster one, unless the profile sets more."""
    on_cluster = workflow.non_local_exec or workflow.remote_exec  # told after the rules
    return 1 if on_cluster else workflow.cores or 1


def threads(wildcards):
    """A job's share of the cores: as many acquisitions as there are run side by side."""
    return max(1, all_cores(wildcards) // len(SETTINGS.acquisitions))


def scene_settings(wildcards):
    """What is true of a scene, however often and by whatever method it is acquired."""
    return SETTINGS.scenes[wildcards.scene].itself()


def capture(wildcards):
    """How the pictures of a scene are taken."""
    return of_scene(wildcards.scene).capture


def camera(wildcards):
    """The simulated camera before a scene, None for exact radiance."""
    return simulation(wildcards.scene)["camera"]


# Where a real rig is, how long to wait for it and what puts a scene before it: resources, since it
# shapes no result.
WHERE_THE_RIG_IS = {
    "rig_url": lambda wildcards: capture(wildcards).url,
    "rig_token_file": lambda wildcards: capture(wildcards).token_file or "",
    "rig_patience": lambda wildcards: str(capture(wildcards).patience_seconds),
    "rig_placing": lambda wildcards: capture(wildcards).placing or "",
}


def simulated_rig(wildcards):
    """What else shapes the frames of a simulated rig."""
    about = simulation(wildcards.scene)
    return {name: about[name] for name in ("seed", "seconds_per_pattern")}


def plan(wildcards):
    """Arguments of the Plan that the stages of an acquisition follow."""
    return plan_of(SETTINGS, wildcards.scene, wildcards.method)


def stages(wildcards):
    """What the stages of an acquisition do, before any rig, and the code that they do it with."""
    return stages_of(SETTINGS, wildcards.scene, wildcards.method)


def verification(wildcards):
    """What the verification of an acquisition does, before any rig."""
    return verification_of(SETTINGS, wildcards.scene, wildcards.method)


def every_acquisition(name):
    """A file of each scene and method."""
    return [
        f"results/{scene}/{method}/{name}" for scene, method in SETTINGS.acquisitions
    ]


def every_verification(wildcards):
    """The verification of each scene and method, if there are to be any."""
    return [
        f"results/{scene}/{method}/verification.json"
        for scene, method in SETTINGS.acquisitions
        if of_scene(scene).verification_pictures
    ]


def every_view(wildcards):
    """The page of each scene and method on which one paints with light."""
    return [
        f"results/report/view/{scene}_{method}.html"
        for scene, method in SETTINGS.acquisitions
    ]


def level_manifest(wildcards, level):
    """What says that a level of an acquisition is done."""
    return f"results/{wildcards.scene}/{wildcards.method}/L{int(level):02d}/refine.json"


def levels_before(wildcards):
    """Levels that are jobs of their own: each tells whether there is another one."""
    if SETTINGS.resources.jobs == "acquisition":
        return []
    folder = AcquisitionFolder(Path("results", wildcards.scene, wildcards.method))
    found, level = [], 0
    while level is not None:
        done = checkpoints.level.get(**wildcards, level=f"{level:02d}")
        found.append(done.output[0])
        level = level_after(folder, level)
    return found


def previous_level(wildcards):
    """The level that a level's schedule follows from; none for the first."""
    folder = AcquisitionFolder(Path("results", wildcards.scene, wildcards.method))
    before = level_before(folder, int(wildcards.level))
    return [] if before is None else level_manifest(wildcards, before)


def list_collection():
    """Write the catalogue of a collection, whatever became of it until now."""
    if SETTINGS.collection is None:
        return
    from rfpipe.report.catalogue import write_catalogue

    try:
        counts = write_catalogue(SETTINGS, Path("results"))
    except (
        RfpipeError
    ) as error:  # a page more or less changes nothing of how a run ended
        print(f"rfpipe: no catalogue: {error}")
        return
    said = ", ".join(f"{count} {state}" for state, count in counts.items() if count)
    print(f"rfpipe: results/catalogue/index.html: {said}")


def every_item(wildcards):
    """What the catalogue tells of each scene and method beside its transport."""
    relit = [
        f"results/{scene}/{method}/relight.json"
        for scene, method in SETTINGS.acquisitions
        if SETTINGS.scenes[scene].has_truth
    ]
    return [*relit, *every_verification(wildcards), *every_view(wildcards)]


def other_acquisitions(wildcards):
    """The transports of a scene by its other methods."""
    return [
        f"results/{wildcards.scene}/{method}/transport.json"
        for method in SETTINGS.methods_of(wildcards.scene)
        if method != wildcards.method
    ]


def every_sweep(name):
    """A file of each scene and method that is acquired at several tolerances."""
    return [
        f"results/{scene}/{method}/{name}"
        for scene, method in SETTINGS.acquisitions
        if is_swept(SETTINGS, scene, method)
    ]


def sweep_settings(wildcards):
    """The settings of one scene and method's sweep."""
    section = SETTINGS.methods_of(wildcards.scene)[wildcards.method]
    shaping = of_scene(wildcards.scene).shaping()
    return {
        **{name: part for name, part in shaping.items() if name != "verification"},
        "scenes": {wildcards.scene: scene_settings(wildcards)},
        "methods": {wildcards.method: plain(section)},
        "report": {"trials": SHAPING["report"]["trials"]},
    }


def relight_code(wildcards):
    """Fingerprint of the code of the relighting beside what is true of a scene."""
    return stage_code(
        "stages.relight", module_of(SCENES, scene_settings(wildcards)["kind"])
    )


def sweep_code(wildcards):
    """Fingerprint of the code of a method's sweep."""
    scene = module_of(SCENES, scene_settings(wildcards)["kind"])
    method = module_of(METHODS, plan(wildcards)["method"])
    return stage_code("stages.evaluating.sweep", method, scene)


def study_code(wildcards):
    """Fingerprint of the code of the studies, which compare methods."""
    made_with = [module_of(METHODS, name) for name in method_names()]
    if wildcards.study in FIGURES:
        made_with.append(f"rfpipe.stages.evaluating.studies.{FIGURES[wildcards.study]}")
        made_with.append("rfpipe.scenes.kinds.mitsuba")
    return stage_code("stages.evaluating.studies", *made_with)


def report_code(wildcards):
    """Fingerprint of the code of the report, which shows the methods as they describe themselves."""
    acquired = {
        plan_of(SETTINGS, scene, name)["method"]
        for scene, name in SETTINGS.acquisitions
    }
    methods = {module_of(METHODS, name) for name in acquired.union(method_names())}
    return stage_code("report", *sorted(methods))


def study_settings(wildcards):
    """The settings of the studies, which have scenes of their own."""
    settings = {
        **SHAPING,
        "capture": {**SHAPING["capture"], "rig": "simulated"},
        "report": {
            name: SHAPING["report"][name]
            for name in (["figures"] if wildcards.study in FIGURES else ["resolutions"])
        },
    }
    del settings["scenes"], settings["verification"]
    return settings


def calibration_needs(wildcards):
    """Manifests of the steps that a step builds on."""
    needs = CALIBRATION_STEPS[wildcards.step].needs
    return [f"{CALIBRATION}/steps/{name}.json" for name in needs]


def calibration_settings(wildcards):
    """The rig's settings, with those of the calibration that shape this step alone."""
    step = CALIBRATION_STEPS[wildcards.step]
    shaping = RIG.calibrate.model_dump(mode="json", include={"coaxial", *step.settings})
    rig = RIG.model_dump(
        mode="json", exclude={"calibrate", "calibration", "seconds_per_pattern"}
    )
    return {**rig, "calibrate": shaping}
