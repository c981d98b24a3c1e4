from rfpipe.stages import refine
from rfpipe.stages.job import start
from rfpipe.stages.plan import AcquisitionFolder, Plan
from rfpipe.stages.workers import Resources

start(snakemake.log[0])
refine.run(
    Plan(**snakemake.params.plan),
    AcquisitionFolder.of_manifest(snakemake.output[0]),
    int(snakemake.wildcards.level),
    snakemake.params.code,
    resources=Resources.of_job(snakemake),
)
