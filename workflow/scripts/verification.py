from rfpipe.stages import verification
from rfpipe.stages.job import stage_job

with stage_job(snakemake) as job:
    verification.run(job.capture_context(), snakemake.params.pictures)
