from rfpipe.stages.job import stage_job
from rfpipe.stages.merge import drop_raw

with stage_job(snakemake) as job:
    drop_raw(job.storage)
