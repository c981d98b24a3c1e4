from pathlib import Path

from rfpipe.stages import captures, levels
from rfpipe.stages.folder import AcquisitionFolder
from rfpipe.stages.jobs.job import start
from rfpipe.stages.jobs.workers import Resources
from rfpipe.stages.plan import Plan

params = snakemake.params
start(snakemake.log[0])
resources = Resources.of_job(snakemake)
levels.run(
    Plan(**params.plan),
    AcquisitionFolder(Path(snakemake.output[0]).parent, believing=True),
    snakemake.wildcards.scene,
    captures.by_simulation(params.scene, params.camera, resources.threads, **params.rig),
    **params.stages,
    resources=resources,
)
