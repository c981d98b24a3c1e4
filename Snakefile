"""rfpipe: from patterns to a relightable light transport and its report.

Each scene of the configuration is acquired with each method, level by level. The method's state
determines the patterns of a level (schedule), the rig displays them and takes their pictures
(capture), brackets become radiance images (merge), which are scaled to add up to the floodlit image
(normalize), and the method's state is refined by them (refine). The schedule of a level has no
patterns if the acquisition is complete. The transport is assembled from all levels, verified by
pictures that the method didn't use (verification), relit, compared with the true transport of a
simulated scene, put on a page on which the user paints with light (view), and reported.

Each stage writes a store and, last, a small manifest beside it, in
results/{scene}/{method}/L{level}: rules depend on manifests alone. A store records the fingerprint
of its inputs, and a capture that was stopped continues at its journal. If the setting
resources.jobs is acquisition, a single job runs all stages of an acquisition, to the same bytes.
"""

import os
from pathlib import Path

from rfpipe.jobs.forked_scripts import fork_scripts
from rfpipe.jobs.snakemake import (
    explain_reruns,
    list_changed_parameters_alone,
    notify,
    say_failed_jobs,
)
from rfpipe.jobs.outcome import FailedJobs, clear_failures, write_failures
from rfpipe.jobs.snakemake_lock import hold
from rfpipe.storage.run_record import write_run_record
from snakemake.logging import logger
from snakemake.utils import min_version

min_version("9.27")

# Read by workflow/envs/rfpipe.post-deploy.sh, which installs rfpipe from this folder.
os.environ.update(RFPIPE_HOME=str(workflow.basedir))


list_changed_parameters_alone()
explain_reruns()
if workflow.is_main_process:
    fork_scripts()
failed_jobs = FailedJobs()
logger.addHandler(failed_jobs)

# Settings given with --configfile replace those of the default run; they aren't merged.
if not workflow.overwrite_configfiles:

    configfile: Path(workflow.basedir) / "config" / "config.yaml"


include: "workflow/rules/common.smk"


if SETTINGS.jobs == "stage":

    include: "workflow/rules/levels.smk"
    include: "workflow/rules/schedule.smk"
    include: "workflow/rules/capture.smk"
    include: "workflow/rules/merge.smk"
    include: "workflow/rules/normalize.smk"
    include: "workflow/rules/refine.smk"
    include: "workflow/rules/assemble.smk"

else:

    include: "workflow/rules/acquire.smk"


include: "workflow/rules/drop_raw.smk"
include: "workflow/rules/verification.smk"
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
        ["results/verified"] if BOUNDS else [],
        ["results/kept.json"] if SETTINGS.storage.keep_at else [],
        raw_to_drop,


onstart:
    hold()
    clear_failures(Path("results"))
    if workflow.non_local_exec:
        say_failed_jobs(logger)
    write_run_record(
        Path("results"),
        Path(workflow.main_snakefile),
        workflow.overwrite_configfiles,
        workflow.config_settings.config,
        SETTINGS.acquisitions,
    )
    list_collection()


onsuccess:
    print("rfpipe: done.")
    notify(SETTINGS.notify, "done", log[0])
    list_collection()


onerror:
    write_failures(Path("results"), failed_jobs.failures())
    if workflow.execution_settings.keep_going:
        report_remaining(failed_jobs.failures())
    print(
        "rfpipe: the run ended early. If a stage failed, its message is above and, with more "
        "detail, in the .log file beside its results. All captured pictures are kept. After a signal, "
        "or if that message says so, the next run continues."
    )
    notify(SETTINGS.notify, "failed", log[0])
    list_collection()
