from rfpipe.stages.captures import by_simulation
from rfpipe.stages.stage_job import stage_job

with stage_job(snakemake) as job:
    capture = by_simulation(**job.params.rig, threads=job.resources.threads)
    capture(job.folder, job.level, **job.settings, resources=job.resources.here)
