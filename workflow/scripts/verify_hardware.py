from pathlib import Path

from rfpipe.stages import captures
from rfpipe.stages.folder import AcquisitionFolder
from rfpipe.stages.jobs.job import start
from rfpipe.stages.jobs.workers import Resources
from rfpipe.stages.plan import Plan
from rfpipe.stages.unseen import verify

params = snakemake.params
start(snakemake.log[0])
verify.run(
    AcquisitionFolder(Path(snakemake.output[0]).parent, believing=True),
    captures.by_server(Plan(**params.plan), snakemake.resources),
    **params.stages,
    resources=Resources.of_job(snakemake),
)
