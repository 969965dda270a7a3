"""Run a program and print its seconds, processor seconds, peak memory in bytes, and exit status as JSON.

    python -IS launch.py LONGEST COMMAND...

A program that takes longer than LONGEST seconds is stopped; its status is null.

A process of its own, as the kernel counts the memory of the process that starts a program as the program's.
"""

import json
import resource
import subprocess
import sys
import time

start = time.perf_counter()
try:
    status = subprocess.run(sys.argv[2:], stdout=subprocess.DEVNULL, timeout=float(sys.argv[1])).returncode
except subprocess.TimeoutExpired:
    status = None
seconds = time.perf_counter() - start
used = resource.getrusage(resource.RUSAGE_CHILDREN)
processor, peak = used.ru_utime + used.ru_stime, 1024 * used.ru_maxrss  # maxrss is that of the largest process
print(json.dumps({"seconds": seconds, "processor": processor, "peak": peak, "status": status}))
