from rfpipe.stages import acquisition, captures
from rfpipe.stages.stage_job import stage_job

with stage_job(snakemake) as job:
    capture = captures.of_job(job)
    acquisition.run(job.plan, job.folder, capture, job.settings, job.resources)
