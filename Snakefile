"""rfpipe: from patterns to a relightable light transport and its report.

Each scene of the configuration is acquired with each method, level by level: the levels above
decide on the patterns of a level (schedule), the rig shows them (capture), brackets become radiance
(merge) that adds up to the floodlit image (normalize), and the method learns from it (refine). The
transport is assembled from all levels, verified by pictures that no method saw (verify), relit,
compared with the truth, put on a page on which one paints with light (view), and reported.

An acquisition is one job, since a level is little work beside a job's start. Where a cluster ends
long jobs, or a rig shall be free while pictures are processed, the setting resources.jobs makes each
level a job of its own before it (docs/clusters.md): a checkpoint, since how many levels have
patterns to show turns out on the way. Each of its stages leaves a store and, written last, a
small manifest beside it, in results/{scene}/{method}/L{level}. Stores know what they were made
from: a job that was stopped goes on where it stopped, and one that runs again does only what
changed settings or code change.
"""

import os
from pathlib import Path

from snakemake.utils import min_version

min_version("9.27")

# Where workflow/envs/rfpipe.post-deploy.sh finds what it installs.
os.environ.update(RFPIPE_HOME=str(workflow.basedir))


# Settings given with --configfile take the place of the default run's, rather than joining them.
if not workflow.overwrite_configfiles:

    configfile: Path(workflow.basedir) / "config" / "config.yaml"


include: "workflow/rules/common.smk"
include: f"workflow/rules/acquire_{SETTINGS.capture.rule}.smk"


if SETTINGS.resources.jobs == "level":

    include: f"workflow/rules/levels_{SETTINGS.capture.rule}.smk"


include: "workflow/rules/relight.smk"
include: "workflow/rules/view.smk"
include: "workflow/rules/report.smk"
include: "workflow/rules/keep.smk"
include: "workflow/rules/calibrate.smk"


rule all:
    default_target: True
    input:
        every_acquisition("transport.json"),
        ["results/report/index.html"] if SETTINGS.has_report else every_item,
        ["results/verified"] if SETTINGS.verification.fail_above else [],
        ["results/kept.json"] if SETTINGS.storage.keep_at else [],


onstart:
    if SETTINGS.report.figures is not None and not workflow.non_local_exec:
        from rfpipe.scenes.mitsuba.variant import need_llvm

        need_llvm("report.figures")
    if workflow.non_local_exec:
        check_groups(workflow.group_settings.group_components, workflow.cores)
        logger.addHandler(FailedJobs(logger.error))
    write_run(
        Path("results"),
        Path(workflow.main_snakefile),
        workflow.overwrite_configfiles,
        workflow.config_settings.config,
    )
    list_collection()


onsuccess:
    print("rfpipe: done.")
    notify(SETTINGS.notify, "done", log[0])
    list_collection()


onerror:
    print(
        "rfpipe: the run ended early. If a stage failed, its message stands above and, with more "
        "detail, in the .log file beside its results. What was captured is kept: the next run goes "
        "on from there."
    )
    notify(SETTINGS.notify, "failed", log[0])
    list_collection()
