from rfpipe.stages import schedule
from rfpipe.stages.stage_job import stage_job

with stage_job(snakemake) as job:
    schedule.run(job.plan, job.folder, job.level, **job.settings)
