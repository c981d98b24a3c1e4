from pathlib import Path

from rfpipe.jobs.job import start
from rfpipe.stages.verification import check_bounds
from rfpipe.store import read_manifest

start(snakemake.log[0])
paths = [Path(path) for path in snakemake.input.acquired]
check_bounds(
    {f"{path.parent.parent.name} by {path.parent.name}": read_manifest(path) for path in paths},
    snakemake.params.bounds,
    f"{snakemake.input.get('page') or 'results/catalogue/index.html'}#verification",
)
