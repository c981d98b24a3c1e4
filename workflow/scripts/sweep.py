from pathlib import Path

from rfpipe.config import Config
from rfpipe.stages.evaluating import sweep
from rfpipe.stages.jobs.job import start

start(snakemake.log[0])
sweep.run(
    Config(**snakemake.params.settings),
    snakemake.wildcards.scene,
    snakemake.wildcards.method,
    Path(snakemake.output[0]).parent,
    snakemake.params.code,
)
