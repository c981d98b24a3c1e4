from rfpipe.stages import merge
from rfpipe.stages.capturing.sensors import read_sensor
from rfpipe.stages.stage_job import stage_job

with stage_job(snakemake) as job:
    sensor = read_sensor(job.folder)
    merge.run(sensor, job.folder, job.level, **job.settings, resources=job.resources)
