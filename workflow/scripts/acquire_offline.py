from pathlib import Path

from rfpipe.config import parse_config
from rfpipe.errors import PicturesNeeded
from rfpipe.stages.jobs.job import start
from rfpipe.stages.jobs.workers import Resources
from rfpipe.stages.offline import OfflineAcquisition

start(snakemake.log[0])
acquisition = OfflineAcquisition(
    parse_config(snakemake.config, "the configuration"),
    snakemake.wildcards.scene,
    snakemake.wildcards.method,
    Path(snakemake.output[0]).parent,
)
level = acquisition.advance(acquisition.rig(), Resources.of_job(snakemake))
if level is not None:
    raise PicturesNeeded(
        f"level {level} waits for pictures: write its patterns with 'rfpipe patterns CONFIG', take "
        "them, and read the pictures with 'rfpipe import FOLDER'"
    )
