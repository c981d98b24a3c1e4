"""Jobs of a run: logs, progress, memory and threads, Snakemake, and the outcome of a run."""
