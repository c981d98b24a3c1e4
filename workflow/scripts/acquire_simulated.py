from pathlib import Path

from rfpipe.stages import captures, levels
from rfpipe.stages.folder import AcquisitionFolder
from rfpipe.stages.jobs.job import start
from rfpipe.stages.jobs.settings import asked_of
from rfpipe.stages.jobs.workers import Resources
from rfpipe.stages.plan import Plan

params, wildcards = snakemake.params, snakemake.wildcards
start(snakemake.log[0])
resources = Resources.of_job(snakemake)
simulation = {"scene": params.scene, "camera": params.camera, **params.rig}
levels.run(
    Plan(**params.plan),
    AcquisitionFolder(Path("results", wildcards.scene, wildcards.method), believing=True),
    wildcards.scene,
    captures.by_simulation(**simulation, threads=resources.threads),
    **params.stages,
    resources=resources,
    until=levels.Until.of_job(snakemake),
    asked=asked_of(params.plan, params.stages, simulation),
)
