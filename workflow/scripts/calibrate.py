from pathlib import Path

from rfpipe.calibration.folder import CalibrationFolder
from rfpipe.calibration.run import finish
from rfpipe.config import CalibrationConfig
from rfpipe.jobs.job import start
from rfpipe.report.calibration import build_calibration_report

start(snakemake.log[0])
folder = CalibrationFolder(Path(snakemake.output.facts).parent)
finish(folder, CalibrationConfig(**snakemake.params.settings))
build_calibration_report(folder)
