from pathlib import Path

from rfpipe.config import SceneSettings
from rfpipe.stages import relight
from rfpipe.stages.jobs.job import start

start(snakemake.log[0])
relight.run(
    Path(snakemake.output[0]).parent,
    SceneSettings.model_validate(snakemake.params.scene),
    snakemake.params.code,
)
