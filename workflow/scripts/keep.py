from dataclasses import asdict
from pathlib import Path

from rfpipe.jobs.job import start
from rfpipe.publishing.keep import keep
from rfpipe.publishing.run import find_run
from rfpipe.store import write_manifest

start(snakemake.log[0])
output = Path(snakemake.output[0])
write_manifest(output, asdict(keep(find_run(output.parent), snakemake.params.address)))
