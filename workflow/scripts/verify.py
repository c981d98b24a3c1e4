from rfpipe.stages import captures
from rfpipe.stages.stage_job import stage_job
from rfpipe.stages.unseen import verify

with stage_job(snakemake) as job:
    verify.run(
        job.folder,
        captures.of_job(job),
        pictures=job.params.pictures,
        settings=job.settings,
        resources=job.resources,
    )
