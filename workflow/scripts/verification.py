from rfpipe.stages import verification
from rfpipe.stages.acquisition import stage_job

with stage_job(snakemake) as job:
    verification.run(
        job.folder,
        job.capture,
        pictures=job.params.pictures,
        settings=job.stages,
        resources=job.resources,
    )
