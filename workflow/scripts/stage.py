from rfpipe.stages.stage_job import stage_job

with stage_job(snakemake) as job:
    job.do(snakemake.rule)
