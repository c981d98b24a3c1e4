from rfpipe.stages.acquisition import acquire_transport
from rfpipe.stages.job import stage_job

with stage_job(snakemake) as job:
    acquire_transport(job.acquisition("acquire"))
