#!/usr/bin/env bash
# Into the conda environment that Snakemake has just made: RFPIPE_HOME is set by the Snakefile.
set -euo pipefail
if [ ! -f "$RFPIPE_HOME/requirements.lock" ]; then
  echo "rfpipe: conda environments are made from a clone of rfpipe, with its requirements.lock;" \
    "$RFPIPE_HOME has none. Run the Snakefile of a clone" >&2
  exit 1
fi
python -m pip install --require-hashes --requirement "$RFPIPE_HOME/requirements.lock"
python -m pip install --no-deps --no-build-isolation --editable "$RFPIPE_HOME"
