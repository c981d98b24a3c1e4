from pathlib import Path

from rfpipe.config import SceneSettings
from rfpipe.jobs.job import start
from rfpipe.stages import relight

start(snakemake.log[0])
relight.run(
    Path(snakemake.output[0]).parent,
    SceneSettings.model_validate(snakemake.params.scene),
    snakemake.params.code,
)
