from rfpipe.stages import hardware
from rfpipe.stages.jobs.job import start
from rfpipe.stages.jobs.workers import Resources
from rfpipe.stages.plan import AcquisitionFolder, Plan

params, resources = snakemake.params, snakemake.resources
start(snakemake.log[0])
hardware.run(
    Plan(**params.plan),
    AcquisitionFolder.of_manifest(snakemake.output[0]),
    int(snakemake.wildcards.level),
    url=resources.rig_url,
    token_file=resources.rig_token_file or None,
    patience_seconds=float(resources.rig_patience),
    references=tuple(params.references),
    expected_patterns=params.expected_patterns,
    **params.capture,
    resources=Resources.of_job(snakemake),
)
