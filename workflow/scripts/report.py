from pathlib import Path

from rfpipe.config import Config
from rfpipe.report import build_report
from rfpipe.stages.jobs.job import start

start(snakemake.log[0])
page = Path(snakemake.output.page)
build_report(
    Config(**snakemake.params.settings),
    page.parents[1],
    page,
    Path(snakemake.input.errors),
    Path(snakemake.input.speed_error),
)
