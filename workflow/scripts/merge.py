from rfpipe.config import CameraConfig
from rfpipe.photometry import sensor_from_config
from rfpipe.stages import merge
from rfpipe.stages.job import start
from rfpipe.stages.plan import AcquisitionFolder
from rfpipe.stages.workers import Resources

params = snakemake.params
start(snakemake.log[0])
merge.run(
    sensor_from_config(CameraConfig(**params.camera) if params.camera else None),
    AcquisitionFolder.of_manifest(snakemake.output[0]),
    int(snakemake.wildcards.level),
    **params.merge,
    code=params.code,
    keep_raw=params.keep_raw,
    resources=Resources.of_job(snakemake),
)
