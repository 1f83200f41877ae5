"""A cluster on this machine, as the fixture `cluster` starts it."""

import subprocess

Cluster = tuple[str, list[subprocess.Popen[bytes]]]  # a scheduler's address; its process and those of two workers
