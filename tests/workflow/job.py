"""A job's place in Snakemake's eyes: it hands the script on, and ends as that ends.

Used as ``python -IS job.py SOCKET SCRIPT``; takes a hundredth of what loading the libraries takes.
"""

import json
import os
import socket
import sys
from pathlib import Path

with socket.socket(socket.AF_UNIX) as starter:
    starter.connect(sys.argv[1])
    job = json.dumps([str(Path.cwd()), dict(os.environ), sys.argv[2]]).encode()
    socket.send_fds(starter, [len(job).to_bytes(8, "big")], [0, 1, 2])
    starter.sendall(job)
    status = int.from_bytes(starter.recv(8), "big", signed=True)
sys.exit(status if status >= 0 else 128 - status)
