from rfpipe.stages.job import stage_job

with stage_job(snakemake) as job:
    job.run(snakemake.rule)
