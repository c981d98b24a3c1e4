from pathlib import Path

from rfpipe.stages.jobs.job import start
from rfpipe.stages.verification import check_bound
from rfpipe.store import read_manifest

start(snakemake.log[0])
paths = [Path(path) for path in snakemake.input.verified]
check_bound(
    {f"{path.parent.parent.name} by {path.parent.name}": read_manifest(path) for path in paths},
    snakemake.params.bound,
    f"{snakemake.input.get('page') or 'results/catalogue/index.html'}#verification",
)
