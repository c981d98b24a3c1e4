from rfpipe.stages.captures import by_server
from rfpipe.stages.stage_job import stage_job

with stage_job(snakemake) as job:
    capture = by_server(job.params.rig, job.asked)
    capture(job.folder, job.level, **job.settings, resources=job.resources.here)
