"""A Slurm cluster of two nodes on this machine, with all of its files in one folder."""

from __future__ import annotations

import os
import secrets
import shutil
import signal
import socket
import subprocess
from contextlib import suppress
from pathlib import Path

import psutil
from tests.services.ports import free_port
from tests.services.waiting import wait_until

NODES = ("one", "two")

CONFIGURATION = """
ClusterName=rfpipe
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={controller}
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/%n
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/%n.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/%n.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU_Memory
SchedulerType=sched/builtin
SlurmdTimeout=4
ReturnToService=2
InactiveLimit=0
KillWait=2
MinJobAge=300
AccountingStorageType=accounting_storage/none
JobAcctGatherType=jobacct_gather/none
NodeName=one NodeHostname={host} NodeAddr=127.0.0.1 Port={one} CPUs={cpus} RealMemory=8000
NodeName=two NodeHostname={host} NodeAddr=127.0.0.1 Port={two} CPUs={cpus} RealMemory=8000
PartitionName=work Nodes=one,two Default=YES MaxTime=INFINITE State=UP
"""
# There is no accounting database; squeue and scontrol query the scheduler. It checks for nodes that
# don't answer every SlurmdTimeout / 3.


class Slurm:
    """Daemons of a Slurm cluster, as a context manager that stops them.

    Parameters
    ----------
    folder : Path
    cpus : int
        Number of processors of each node.
    """

    def __init__(self, folder: Path, cpus: int = 1) -> None:
        self.folder = folder
        self.cpus = cpus
        self.environment = {
            **os.environ,
            "SLURM_CONF": str(folder / "slurm.conf"),
            "PATH": f"{folder / 'bin'}:{os.environ['PATH']}",
        }

    def __enter__(self) -> Slurm:
        folder = self.folder
        for name in ("state", "bin", *NODES):
            (folder / name).mkdir(parents=True)
        folder.chmod(0o755)
        # Snakemake's plugin removes SLURM_CONF from the environment
        srun = folder / "bin" / "srun"
        program = f'SLURM_CONF={folder}/slurm.conf exec {shutil.which("srun")} "$@"'
        srun.write_text(f"#!/bin/sh\n{program}\n")
        srun.chmod(0o755)
        key = folder / "munge.key"
        key.write_bytes(secrets.token_bytes(128))
        key.chmod(0o600)
        ports = {name: free_port() for name in ("controller", *NODES)}
        settings = CONFIGURATION.format(
            host=socket.gethostname().partition(".")[0], folder=folder, cpus=self.cpus, **ports
        )
        (folder / "slurm.conf").write_text(settings)
        try:
            files = {"socket": "socket", "pid-file": "pid", "log-file": "log", "seed-file": "seed"}
            self._do(
                "munged", "--force", f"--key-file={key}",
                *(f"--{option}={folder}/munge.{end}" for option, end in files.items()),
            )  # fmt: skip
            self._do("slurmctld")
            for node in NODES:
                self.start_node(node)
            self.wait_for_nodes("idle")
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        for node in NODES:
            self.kill_node(node)
        for name in ("slurmctld", "munge"):
            daemon = self._daemon(name)
            if daemon is not None:
                daemon.kill()

    def start_node(self, node: str) -> None:
        """Start the daemon of a node, or start it again after `kill_node`."""
        self._do("slurmd", "-N", node)

    def kill_node(self, node: str) -> int:
        """Kill a node's daemon and all its processes, as a power cut does; return their number."""
        daemon = self._daemon(node)
        processes = {process for process in psutil.process_iter() if self._is_of(process, node)}
        # the parent that monitors a job would report its end
        processes |= {
            parent
            for process in processes
            if (parent := process.parent()) and _looks_after_jobs(parent)
        }
        processes |= {daemon} if daemon is not None else set()
        for number in (signal.SIGSTOP, signal.SIGKILL):
            for process in processes:
                with suppress(psutil.NoSuchProcess):
                    process.send_signal(number)
        (self.folder / f"{node}.pid").unlink(missing_ok=True)
        return len(processes)

    def jobs(self, *states: str) -> dict[str, str]:
        """Return the nodes of the jobs in the given states, or in any state, by job number."""
        selection = ",".join(states) or "all"
        lines = self._do("squeue", "--noheader", "--format=%i %N", f"--states={selection}")
        return {number: node for number, _, node in (it.partition(" ") for it in lines)}

    def wait_for_nodes(self, state: str, *nodes: str) -> None:
        """Wait until the given nodes, by default all, are in a state."""

        def are() -> bool:
            options = ("--noheader", "--Node", "--format=%t", f"--nodes={','.join(nodes or NODES)}")
            return {line.strip("*") for line in self._do("sinfo", *options)} == {state}

        wait_until(are, f"{nodes} {state}", every=0.2)

    def _do(self, *command: str) -> list[str]:
        done = subprocess.run(
            command, env=self.environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, f"{command}: {done.stderr}"
        return done.stdout.splitlines()

    def _daemon(self, name: str) -> psutil.Process | None:
        try:
            return psutil.Process(int((self.folder / f"{name}.pid").read_text()))
        except (OSError, ValueError, psutil.NoSuchProcess):
            return None

    def _is_of(self, process: psutil.Process, node: str) -> bool:
        try:
            environment = process.environ()
        except psutil.Error:
            return False
        is_ours = environment.get("SLURM_CONF") == self.environment["SLURM_CONF"]
        return is_ours and environment.get("SLURMD_NODENAME") == node


def _looks_after_jobs(process: psutil.Process) -> bool:
    return "slurmstepd:" in " ".join(process.cmdline())
