from rfpipe.stages.acquisition import stage_job

with stage_job(snakemake) as job:
    job.do(snakemake.rule)
