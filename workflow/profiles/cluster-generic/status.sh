#!/usr/bin/env bash
# Print what has become of a Slurm job: running, success or failed. Waits and is queued is running.
set -uo pipefail
# A scheduler that doesn't answer for a moment has lost no job.
for _ in 1 2 3 4 5; do
  state=$(scontrol --oneliner show job "$1" 2>&1) && break
  case $state in
    # forgotten some minutes after its end: its outputs tell the rest
    *'Invalid job id'*) state='JobState=UNKNOWN'; break ;;
  esac
  state='JobState=PENDING'
  sleep 2
done
state=${state#*JobState=}
case ${state%% *} in
  COMPLETED | UNKNOWN) echo success ;;
  PENDING | CONFIGURING | RUNNING | COMPLETING | SUSPENDED | STOPPED | RESIZING | REQUEUED | REQUEUE_* | SIGNALING | STAGE_OUT) echo running ;;
  *) echo failed ;;
esac
