from rfpipe.stages.acquisition import run, stage_job

with stage_job(snakemake) as job:
    run(job.plan, job.folder, job.capture, job.stages, job.resources)
