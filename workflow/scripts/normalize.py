from rfpipe.stages import normalize
from rfpipe.stages.jobs.job import start
from rfpipe.stages.plan import AcquisitionFolder, Plan

start(snakemake.log[0])
normalize.run(
    Plan(**snakemake.params.plan),
    AcquisitionFolder.of_manifest(snakemake.output[0]),
    int(snakemake.wildcards.level),
    mode=snakemake.params.mode,
    code=snakemake.params.code,
)
