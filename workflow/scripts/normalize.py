from rfpipe.stages import normalize
from rfpipe.stages.stage_job import stage_job

with stage_job(snakemake) as job:
    normalize.run(job.plan, job.folder, job.level, **job.settings)
