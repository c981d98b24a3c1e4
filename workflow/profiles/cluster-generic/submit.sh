#!/usr/bin/env bash
# Submit a job's script to Slurm and print the job's number: submit.sh OPTIONS... SCRIPT
set -euo pipefail
mkdir -p .snakemake/cluster_logs
# Snakemake repeats a job whose node died, with more memory: no requeueing by Slurm
number=$(sbatch --parsable --no-requeue --output=.snakemake/cluster_logs/%x-%j.log "$@")
echo "${number%%;*}"
