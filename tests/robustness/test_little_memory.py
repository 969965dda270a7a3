"""Commands with decreasing memory succeed, or end with one line and status 1."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import pointray as pr
from helpers.clouds import sphere_points

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="a limit of memory, and how much there is of it")

POINTS = 50_000
# The command runs once on a small scan, so that all is loaded, and then in children that get this many MiB more.
PROGRAM = """
import json, os, resource, signal, sys
from pointray.cli import execute, main
folder, rooms, arguments = sys.argv[1], json.loads(sys.argv[2]), sys.argv[3:]
assert execute([text.replace("large.ply", "small.ply") for text in arguments]) == 0
size = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
ends = []
for room in rooms:
    for attempt in range(5):
        child = os.fork()
        if child == 0:
            file = os.open(f"{folder}/said", os.O_CREAT | os.O_TRUNC | os.O_WRONLY)
            os.dup2(file, 1), os.dup2(file, 2)
            resource.setrlimit(resource.RLIMIT_AS, (size + (room << 20),) * 2)
            signal.alarm(60)
            sys.argv[1:] = arguments
            main()
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        said = open(f"{folder}/said").read()
        # threading.Thread.start waits for ever for a thread that finds no memory before it runs.
        if status != -signal.SIGALRM or "ignored in thread started by" not in said:
            break
    ends.append((room, status, said))
print("ENDS" + json.dumps(ends))
"""
COMMANDS = {
    "info": ["info", "{scan}"],
    "render": ["render", "{scan}", "-o", "{folder}/a.png", "--size", "64x64", "--spp", "1"],
    "prepare": ["prepare", "{scan}", "-o", "{folder}/b.ply", "--drop-outliers", "--estimate-normals"],
}


@pytest.mark.long
@pytest.mark.parametrize("command", COMMANDS)
def test_a_lack_of_memory_is_one_line_and_status_1(tmp_path: Path, command: str) -> None:
    for name, count in (("small", 1000), ("large", POINTS)):
        rows = sphere_points(count)
        pr.write(tmp_path / f"{name}.ply", pr.Points(rows, rows))
    arguments = [text.format(scan=tmp_path / "large.ply", folder=tmp_path) for text in COMMANDS[command]]
    rooms = [int(room) for room in np.geomspace(2, 120, 12)]
    command_line = [sys.executable, "-c", PROGRAM, str(tmp_path), json.dumps(rooms), *arguments]
    # One arena: with several, threads without an arena ask the system for every allocation, which is slow.
    environment = {**os.environ, "POINTRAY_THREADS": "4", "MALLOC_ARENA_MAX": "1"}
    done = subprocess.run(command_line, env=environment, capture_output=True, text=True, check=True, timeout=3600)
    ends = json.loads(done.stdout.split("ENDS")[1])
    wrong = [(room, status, output[:300]) for room, status, output in ends if not ended_well(status, output)]
    assert not wrong
    assert any("not enough memory" in output for _, _, output in ends)


def ended_well(status: int, output: str) -> bool:
    # What was found about the scan before memory ran out stays above the error.
    lines = [line for line in output.splitlines() if line and not line.startswith("pointray: note: ")]
    if any("ignored in thread started by" in line for line in lines):  # Python's, without memory for a frame
        lines = [line for line in lines if line.startswith("pointray: ")]
    if status == 0:
        return "not enough memory" not in output
    return status == 1 and len(lines) == 1 and lines[0].startswith("pointray: not enough memory")
