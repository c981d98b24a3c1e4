#!/usr/bin/env bash
# Into the conda environment that Snakemake has just made: RFPIPE_HOME is set by the Snakefile.
set -euo pipefail
python -m pip install --require-hashes --requirement "$RFPIPE_HOME/requirements.lock"
python -m pip install --no-deps --no-build-isolation --editable "$RFPIPE_HOME"
