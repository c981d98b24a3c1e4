from pathlib import Path

from rfpipe.stages import captures, levels
from rfpipe.stages.folder import AcquisitionFolder
from rfpipe.stages.jobs.job import start
from rfpipe.stages.jobs.settings import asked_of
from rfpipe.stages.jobs.workers import Resources
from rfpipe.stages.plan import Plan

params, wildcards = snakemake.params, snakemake.wildcards
start(snakemake.log[0])
plan = Plan(**params.plan)
levels.run(
    plan,
    AcquisitionFolder(Path("results", wildcards.scene, wildcards.method), believing=True),
    wildcards.scene,
    captures.by_server(plan, snakemake.resources),
    **params.stages,
    resources=Resources.of_job(snakemake),
    until=levels.Until.of_job(snakemake),
    asked=asked_of(params.plan, params.stages),
)
