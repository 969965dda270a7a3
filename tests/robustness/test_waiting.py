"""Ctrl-C at any time while waiting for work raises KeyboardInterrupt and causes no hang."""

import signal
import subprocess
import sys
import threading
import time

import pytest

from helpers.marks import long
from pointray import cli
from pointray.cli.waiting import in_background
from pointray.engine.jit import c_threads as alive, threads

# Interrupts at random moments while another thread keeps the interpreter busy.
PROGRAM = """
import random, signal, sys, threading, time
import {module}

signal.signal(signal.SIGINT, signal.default_int_handler)
sys.setswitchinterval(1e-5)
rng, main = random.Random(int(sys.argv[1])), threading.main_thread().ident

def work():
    end = time.perf_counter() + rng.random() * 0.0002
    while time.perf_counter() < end:
        pass
    signal.pthread_kill(main, signal.SIGINT)
    for _ in range(20):
        sum(range(100))

for _ in range(int(sys.argv[2])):
    try:
        {call}
        while True:  # one that has not arrived yet
            pass
    except KeyboardInterrupt:
        pass
"""
WAITS = {
    "pointray.cli.waiting": "pointray.cli.waiting.in_background(work)",
    "pointray.engine.jit.threads": "pointray.engine.jit.threads.run(lambda shared: work(), 1)",
}


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGINT")
@pytest.mark.parametrize("module", WAITS)
@pytest.mark.parametrize("count", [10, long(1_000)])
def test_an_interrupt_at_any_time_is_raised(module: str, count: int) -> None:
    """When the main thread waited with an Event, about one in a thousand hung or became a RuntimeError."""
    program = PROGRAM.format(module=module, call=WAITS[module])
    done = subprocess.run([sys.executable, "-c", program, "1", str(count)], capture_output=True, timeout=600)
    assert (done.returncode, done.stderr) == (0, b"")


def test_an_error_caused_by_an_interrupt_is_recognised(monkeypatch, capsys):
    """Python 3.11 turns an interrupt during a lock of `threading` into a RuntimeError."""

    def app(*arguments, **options):
        try:
            signal.raise_signal(signal.SIGINT)
        finally:
            raise RuntimeError("release unlocked lock")

    monkeypatch.setattr("pointray.cli.commands.app", app)
    assert cli.execute(["demo"]) == cli.INTERRUPTED
    assert capsys.readouterr().err == ""


def test_a_thread_that_ends_silently_is_a_lack_of_memory(monkeypatch):
    """Its function never ran, or had no memory to report its error; both once hung."""
    start = alive.start
    for module in (threads, alive):
        monkeypatch.setattr(module, "start", lambda work: start(lambda: None))
    with pytest.raises(MemoryError):
        threads.run(lambda shared: 1, 8)
    with pytest.raises(MemoryError):
        in_background(lambda: 1)


def test_a_thread_is_there_until_it_ends():
    go_on = threading.Lock()
    go_on.acquire()
    is_there = alive.start(go_on.acquire)
    assert is_there()
    go_on.release()
    while is_there():
        time.sleep(0.001)
