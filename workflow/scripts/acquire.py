from rfpipe.stages import acquisition
from rfpipe.stages.stage_job import stage_job

with stage_job(snakemake) as job:
    acquisition.run(job.plan, job.folder, job.capture, job.params.settings, job.resources)
