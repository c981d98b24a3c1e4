from rfpipe.stages import schedule
from rfpipe.stages.jobs.job import start
from rfpipe.stages.plan import AcquisitionFolder, Plan

start(snakemake.log[0])
schedule.run(
    Plan(**snakemake.params.plan),
    AcquisitionFolder.of_manifest(snakemake.output[0]),
    int(snakemake.wildcards.level),
    snakemake.params.code,
)
