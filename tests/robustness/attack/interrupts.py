"""Ctrl-C in Python: SIGINT at random moments into a process that catches each one and goes on."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

from attack import Attack, CrashError, WrongError
from attack.mutate import Rng

LATEST = 0.25  # seconds until the signal
PATIENCE = 8.0  # seconds until it is sent again: Python loses a signal that comes while it frees an object


class Victim:
    """The process, see `attack.victim`."""

    def __init__(self, seed: int, errors: Path) -> None:
        command = [sys.executable, "-m", "attack.victim", str(seed)]
        with errors.open("wb") as file:
            self._process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=file)
        assert self._process.stdout is not None
        self._pipe, self._rest, self.stage = self._process.stdout.fileno(), b"", ""
        self.wait_for("ready", 1800.0)

    def interrupt(self) -> None:
        """Send the signal."""
        self._process.send_signal(signal.SIGINT)

    def wait_for(self, word: str, seconds: float) -> bool:
        """Read its output up to this line; False if that takes too long, CrashError if the process has ended."""
        end = time.monotonic() + seconds
        while True:
            while b"\n" in self._rest:
                line, _, self._rest = self._rest.partition(b"\n")
                output = line.decode()
                self.stage = output.removeprefix("in ") if output.startswith("in ") else self.stage
                if output == word:
                    return True
            if not select.select([self._pipe], [], [], max(end - time.monotonic(), 0.0))[0]:
                return False
            data = os.read(self._pipe, 1 << 16)
            if not data:
                status = self._process.wait()
                name = signal.Signals(-status).name if status < 0 else f"exit status {status}"
                raise CrashError(f"{name} in {self.stage} after an interrupt")
            self._rest += data

    def end(self) -> None:
        """Kill it, if it still lives."""
        self._process.kill()
        self._process.communicate()


def begin(folder: Path) -> Attack:
    """Interrupts of a process that goes on."""
    victims: list[Victim] = []

    def attack(rng: Rng, index: int) -> bool:
        if not victims:
            victims.append(Victim(int(rng.integers(2**31)), folder / "stderr"))
        victim = victims[0]
        try:
            time.sleep(LATEST * float(rng.random()))
            victim.interrupt()
            if not victim.wait_for("interrupted", PATIENCE):
                victim.interrupt()
                if not victim.wait_for("interrupted", PATIENCE):
                    raise WrongError(f"no KeyboardInterrupt in {victim.stage}")
        except (CrashError, WrongError):
            victims.pop().end()
            raise
        return True

    victims.append(Victim(0, folder / "stderr"))
    return attack
