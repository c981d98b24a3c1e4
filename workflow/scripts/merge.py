from rfpipe.stages import merge
from rfpipe.stages.capturing.sensors import read_sensor
from rfpipe.stages.jobs.job import start
from rfpipe.stages.jobs.workers import Resources
from rfpipe.stages.plan import AcquisitionFolder

params = snakemake.params
start(snakemake.log[0])
folder = AcquisitionFolder.of_manifest(snakemake.output[0])
merge.run(
    read_sensor(folder),
    folder,
    int(snakemake.wildcards.level),
    **params.merge,
    code=params.code,
    keep_raw=params.keep_raw,
    resources=Resources.of_job(snakemake),
)
