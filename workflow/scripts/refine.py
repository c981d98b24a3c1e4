from rfpipe.stages import refine
from rfpipe.stages.jobs.job import start
from rfpipe.stages.jobs.workers import Resources
from rfpipe.stages.plan import AcquisitionFolder, Plan

start(snakemake.log[0])
refine.run(
    Plan(**snakemake.params.plan),
    AcquisitionFolder.of_manifest(snakemake.output[0]),
    int(snakemake.wildcards.level),
    snakemake.params.code,
    resources=Resources.of_job(snakemake),
)
