from functools import partial
from pathlib import Path

from rfpipe.stages import hardware, levels
from rfpipe.stages.folder import AcquisitionFolder
from rfpipe.stages.jobs.job import start
from rfpipe.stages.jobs.workers import Resources
from rfpipe.stages.plan import Plan

params = snakemake.params
start(snakemake.log[0])
resources = Resources.of_job(snakemake)
plan = Plan(**params.plan)
levels.run(
    plan,
    AcquisitionFolder(Path(snakemake.output[0]).parent, believing=True),
    snakemake.wildcards.scene,
    partial(
        hardware.run,
        plan,
        url=snakemake.resources.rig_url,
        token_file=snakemake.resources.rig_token_file or None,
        patience_seconds=float(snakemake.resources.rig_patience),
    ),
    **params.stages,
    resources=resources,
)
