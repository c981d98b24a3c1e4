from functools import partial
from pathlib import Path

from rfpipe.config import CameraConfig, SceneSettings
from rfpipe.photometry import sensor_from_config
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import scene_from_config
from rfpipe.stages import capture
from rfpipe.stages.folder import AcquisitionFolder
from rfpipe.stages.jobs.job import start
from rfpipe.stages.jobs.workers import Resources
from rfpipe.stages.unseen import verify

params = snakemake.params
start(snakemake.log[0])
resources = Resources.of_job(snakemake)
rig = SimulatedRig(
    scene_from_config(SceneSettings.model_validate(params.scene)),
    sensor_from_config(CameraConfig(**params.camera) if params.camera else None),
    **params.rig,
    threads=resources.threads,
)
verify.run(
    AcquisitionFolder(Path(snakemake.output[0]).parent, believing=True),
    partial(capture.run, rig),
    **params.stages,
    resources=resources,
)
