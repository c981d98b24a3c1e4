from pathlib import Path

from rfpipe.calibration.run import calibrate_rig
from rfpipe.config import RigConfig
from rfpipe.jobs.job import Progress, start

start(snakemake.log[0])
calibrate_rig(
    RigConfig(**snakemake.params.rig),
    Path(snakemake.output[0]).parents[1],
    only=[snakemake.wildcards.step],
    progress=Progress,
)
