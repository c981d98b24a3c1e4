from rfpipe.stages.stage_job import stage_job
from rfpipe.stages.unseen import verify

with stage_job(snakemake) as job:
    verify.run(
        job.folder,
        job.capture,
        pictures=job.params.pictures,
        settings=job.params.settings,
        resources=job.resources,
    )
