from rfpipe.stages import refine
from rfpipe.stages.stage_job import stage_job

with stage_job(snakemake) as job:
    refine.run(job.plan, job.folder, job.level, **job.settings, resources=job.resources)
