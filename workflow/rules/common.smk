# The validated settings, and functions that select those of each rule.

from functools import cache, partial
from math import prod
from pathlib import Path

import rfpipe
from rfpipe.config import load_config, parse_config, read_yaml
from rfpipe.errors import ConfigError, RfpipeError
from rfpipe.provenance import code_digest
from rfpipe.storage.files import FolderStorage
from rfpipe.jobs.snakemake import check_no_braces
from rfpipe.jobs.workers import machine_memory_mb
from rfpipe.stages.settings import (
    OPERATING_SETTINGS,
    check_priors,
    operating_settings,
    plan_settings,
    prior_inputs,
    rig_source_settings,
    stage_code,
    stage_settings,
)

for configfile in workflow.configfiles:
    read_yaml(configfile)  # refuses YAML that Snakemake would misread
if len(workflow.configfiles) == 1:
    load_config(workflow.configfiles[0])  # refuses repeated keys, too
SETTINGS = parse_config(
    config, "the configuration", [Path(file).parent for file in workflow.configfiles]
)
# All settings that shape a result.
SHAPING = SETTINGS.result_settings()

check_no_braces("the run's folder", Path.cwd())
check_no_braces("the workflow's folder", Path(workflow.current_basedir))

check_priors(SETTINGS, Path("results"))

if workflow.storage_settings.default_storage_provider:
    raise ConfigError(
        "--default-storage-provider: Snakemake would bring the manifests of captures and results "
        "into a bucket, and leave their stores behind; set storage.keep_at in place of it "
        "(docs/stores.md)"
    )

# Jobs that run side by side on this machine share its memory; --resources mem_mb=... says less.
MACHINE_MB = machine_memory_mb()
on_one = workflow.nodes is None and not workflow.remote_exec
if on_one and "mem_mb" not in workflow.global_resources:
    workflow.register_resource("mem_mb", MACHINE_MB)


wildcard_constraints:
    scene="|".join(SETTINGS.scenes),
    method="|".join(sorted({method for _, method in SETTINGS.acquisitions})),
    level=r"\d+",


of_scene = cache(
    SETTINGS.of_scene
)  # settings of the run, overridden by those of the scene


def memory_mb(wildcards, attempt):
    """Memory of a job in MB, doubled after each failure."""
    settings = of_scene(wildcards.scene) if "scene" in wildcards.keys() else SETTINGS
    requested = int(settings.resources.memory_gib * 2**30 / 10**6)
    return min(requested, MACHINE_MB) * 2 ** (attempt - 1)


def minutes(at_most):
    """Minutes that a job requests from a scheduler, doubled after each failure."""
    return lambda wildcards, attempt: at_most * 2 ** (attempt - 1)


# Snakemake runs a job again when its params change, but not when its resources change. So settings
# that shape no result are resources: memory, workers, and how pictures are taken and kept.
ASKED = {"mem_mb": memory_mb, "runtime": minutes(60)}


def operating_setting(name):
    """One of the settings of how pictures are taken and kept, as text."""
    return lambda wildcards: str(operating_settings(SETTINGS, wildcards.scene)[name])


WITHIN = {
    **ASKED,
    "memory_gib": lambda wildcards: str(of_scene(wildcards.scene).resources.memory_gib),
    "workers": lambda wildcards: of_scene(wildcards.scene).resources.workers,
    **{name: operating_setting(name) for name in OPERATING_SETTINGS},
}

# A real rig takes one picture at a time. Its address, and the command that puts a scene before it,
# shape no result either.
HAS_RIG = SETTINGS.capture.rig == "remote"
CAPTURED_HERE = HAS_RIG and SETTINGS.resources.captures == "here"


def rig_access(name):
    """A setting of the access to the rig, as text."""
    return lambda wildcards: str(getattr(of_scene(wildcards.scene).capture, name) or "")


ACCESS = ("url", "token_file", "patience_seconds", "placing")
AT_THE_RIG = {"rig": 1, **{f"rig_{name}": rig_access(name) for name in ACCESS}}
AT_THE_RIG = AT_THE_RIG if HAS_RIG else {}


def all_cores(wildcards):
    """Cores of this machine that a job may use; on a cluster 1, unless the profile sets more."""
    on_cluster = (
        workflow.non_local_exec or workflow.remote_exec
    )  # known after the rules are read
    return 1 if on_cluster else workflow.cores or 1


def threads(wildcards):
    """Cores of a job: their number over that of the acquisitions, which run side by side."""
    return max(1, all_cores(wildcards) // len(SETTINGS.acquisitions))


def rays(wildcards):
    """Number of a scene's rays: the jobs of the largest begin first, the others run beside them."""
    return prod(SETTINGS.scenes[wildcards.scene].ray_shape)


cached_settings = cache(partial(stage_settings, SETTINGS))


def settings_of(*stages):
    """The settings that shape the results of stages, by default of all stages."""
    return lambda wildcards: cached_settings(wildcards.scene, wildcards.method, *stages)


def plan(wildcards):
    """Method, options and rays of an acquisition."""
    return plan_settings(SETTINGS, wildcards.scene, wildcards.method)


def prior(wildcards):
    """The file that changes with the transport with which an acquisition begins."""
    return prior_inputs(SETTINGS, wildcards.scene, wildcards.method)


def rig(wildcards):
    """Kind and settings of the rig that takes a scene's pictures."""
    return rig_source_settings(SETTINGS, wildcards.scene)


def every_acquisition(name, wanted=lambda scene: True):
    """A file of each scene and method."""
    return [
        f"results/{scene}/{method}/{name}"
        for scene, method in SETTINGS.acquisitions
        if wanted(scene)
    ]


def raw_to_drop(wildcards):
    """The acquisitions whose merged raw exposures are no longer to be kept."""
    return [
        f"results/{scene}/{method}/raw_dropped"
        for scene, method in SETTINGS.acquisitions
        if not of_scene(scene).capture.keep_raw
        and FolderStorage(Path("results", scene, method)).has_merged_raw()
    ]


def scene_settings(wildcards):
    """Settings of a scene that do not depend on its acquisition."""
    return SETTINGS.scenes[wildcards.scene].scene_options()


def every_view(wildcards):
    """The viewer's page of each scene and method."""
    return [
        f"results/report/view/{scene}_{method}.html"
        for scene, method in SETTINGS.acquisitions
    ]


def other_acquisitions(wildcards):
    """The transports of a scene by its other methods."""
    return [
        f"results/{wildcards.scene}/{method}/transport.json"
        for method in SETTINGS.methods_of(wildcards.scene)
        if method != wildcards.method
    ]


def every_verification(wildcards):
    """The verification of each scene and method, if there are to be any."""
    return every_acquisition(
        "verification.json", lambda scene: of_scene(scene).verification_pictures
    )


# The mean error of each acquisition above which the run fails, where there is such a bound.
BOUNDS = {
    f"{scene} by {method}": SETTINGS.bound_of(scene, method)
    for scene, method in SETTINGS.acquisitions
    if SETTINGS.bound_of(scene, method) is not None
}


def every_bounded(wildcards):
    """The verification of each acquisition that has a bound, or else its transport."""
    return [
        f"results/{scene}/{method}/{name}.json"
        for scene, method in SETTINGS.acquisitions
        for name in [
            "verification" if of_scene(scene).verification_pictures else "transport"
        ]
        if f"{scene} by {method}" in BOUNDS
    ]


def every_item(wildcards):
    """Inputs of the catalogue besides the transports."""
    relit = [
        f"results/{scene}/{method}/relight.json"
        for scene, method in SETTINGS.acquisitions
        if SETTINGS.scenes[scene].has_truth
    ]
    return [*relit, *every_verification(wildcards), *every_view(wildcards)]


def list_collection():
    """Write the catalogue of a collection in its present state."""
    if SETTINGS.collection is None:
        return
    from rfpipe.report.catalogue import write_catalogue

    try:
        counts = write_catalogue(SETTINGS, Path("results"))
    except RfpipeError as error:  # a page more or less doesn't change how a run ended
        print(f"rfpipe: no catalogue: {error}")
        return
    states = ", ".join(f"{count} {state}" for state, count in counts.items() if count)
    print(f"rfpipe: results/catalogue/index.html: {states}")


def report_remaining(failures):
    """Write the report of the acquisitions in which no job failed, in a run that keeps going."""
    failed = {
        (failure.scene, failure.method): failure
        for failure in failures
        if failure.scene
    }
    if not failed or len(failed) < len(failures) or not SETTINGS.has_report:
        return
    from rfpipe.report.partial import build_partial_report

    try:
        page = build_partial_report(SETTINGS, Path("results"), failed)
    except RfpipeError as error:
        print(f"rfpipe: no report of the remaining acquisitions: {error}")
    else:
        print(f"rfpipe: report of the remaining acquisitions: {page}" if page else "")
