from rfpipe.stages.captures import by_pictures
from rfpipe.stages.stage_job import stage_job

with stage_job(snakemake) as job:
    capture = by_pictures(**job.params.rig)
    capture(job.folder, job.level, **job.settings, resources=job.resources.here)
