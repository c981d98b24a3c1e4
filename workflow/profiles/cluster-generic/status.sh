#!/usr/bin/env bash
# Print the status of a Slurm job: running (or queued), success or failed.
set -uo pipefail
# If the scheduler doesn't answer, the job counts as running.
for _ in 1 2 3 4 5; do
  state=$(scontrol --oneliner show job "$1" 2>&1) && break
  case $state in
    # Slurm forgets a job some minutes after its end; its outputs then show its success
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
