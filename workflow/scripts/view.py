from pathlib import Path

from rfpipe.jobs.job import start
from rfpipe.viewer import write_acquisition

start(snakemake.log[0])
others = [Path(other).with_suffix(".zarr") for other in snakemake.input.others]
write_acquisition(
    Path(snakemake.input.transport).with_suffix(".zarr"), others, Path(snakemake.output[0])
)
