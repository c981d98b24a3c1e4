from functools import partial
from pathlib import Path

from rfpipe.stages import hardware
from rfpipe.stages.folder import AcquisitionFolder
from rfpipe.stages.jobs.job import start
from rfpipe.stages.jobs.workers import Resources
from rfpipe.stages.plan import Plan
from rfpipe.stages.unseen import verify

params = snakemake.params
start(snakemake.log[0])
resources = Resources.of_job(snakemake)
plan = Plan(**params.plan)
verify.run(
    AcquisitionFolder(Path(snakemake.output[0]).parent, believing=True),
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
