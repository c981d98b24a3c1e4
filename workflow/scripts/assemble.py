from rfpipe.stages import assemble
from rfpipe.stages.stage_job import stage_job

with stage_job(snakemake) as job:
    assemble.run(job.plan, job.folder, **job.settings)
