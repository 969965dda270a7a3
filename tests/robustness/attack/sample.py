"""A sample for the harness's own test: the number of an input decides what it does."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

from attack import Attack, WrongError
from attack.mutate import Rng

ACCEPTED, REFUSED, CRASH, HANG, WRONG, OTHER = (0, 1), (2, 7), 3, 4, 5, 6


def begin(folder: Path) -> Attack:
    """Inputs 0 and 1 are accepted, 2 and 7 refused; the others crash, hang, or fail in two ways."""

    def attack(rng: Rng, index: int) -> bool:
        if index == CRASH:
            os.kill(os.getpid(), signal.SIGSEGV)
        if index == HANG:
            time.sleep(3600)
        if index == WRONG:
            raise WrongError("a result that is none")
        if index == OTHER:
            raise ZeroDivisionError("deep inside")
        return index in ACCEPTED

    return attack
