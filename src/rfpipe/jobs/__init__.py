"""What every job has: a log, progress, threads and memory."""
