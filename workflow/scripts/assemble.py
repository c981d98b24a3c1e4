from pathlib import Path

from rfpipe.stages import assemble
from rfpipe.stages.jobs.job import start
from rfpipe.stages.plan import AcquisitionFolder, Plan

manifest = Path(snakemake.output[0])
start(snakemake.log[0])
assemble.run(
    Plan(**snakemake.params.plan),
    AcquisitionFolder(manifest.parent),
    manifest,
    snakemake.wildcards.scene,
    snakemake.params.number_format,
    snakemake.params.code,
)
