from pathlib import Path

from rfpipe.config import Config
from rfpipe.jobs.job import start
from rfpipe.report import build_report

start(snakemake.log[0])
page = Path(snakemake.output.page)
build_report(
    Config(**snakemake.params.settings),
    page.parents[1],
    page,
    Path(snakemake.input.errors),
    Path(snakemake.input.speed_error),
)
