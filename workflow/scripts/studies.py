from pathlib import Path

from rfpipe.config import Config
from rfpipe.stages.evaluating import studies
from rfpipe.stages.jobs.job import start

start(snakemake.log[0])
studies.run(
    snakemake.wildcards.study,
    Config(**snakemake.params.settings),
    Path(snakemake.output[0]),
    snakemake.params.code,
)
