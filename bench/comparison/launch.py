"""Run a program and print its seconds, processor seconds, peak memory in bytes, and exit status as JSON.

    python -IS launch.py COMMAND...

A process of its own, as the kernel counts the memory of the process that starts a program as the program's.
"""

import json
import resource
import subprocess
import sys
import time

start = time.perf_counter()
status = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL).returncode
seconds = time.perf_counter() - start
used = resource.getrusage(resource.RUSAGE_CHILDREN)
processor, peak = used.ru_utime + used.ru_stime, 1024 * used.ru_maxrss  # maxrss is that of the largest process
print(json.dumps({"seconds": seconds, "processor": processor, "peak": peak, "status": status}))
