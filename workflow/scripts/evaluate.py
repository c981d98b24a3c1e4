from pathlib import Path

from rfpipe.jobs.job import start
from rfpipe.stages import evaluate

start(snakemake.log[0])
evaluate.run(
    [Path(path) for path in snakemake.input.relit],
    Path(snakemake.output.errors),
    Path(snakemake.output.speed_error),
    snakemake.params.seconds_per_pattern,
)
