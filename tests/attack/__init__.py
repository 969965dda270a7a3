"""Attacks: mutated files, interrupts, threads, full disks and kills, as programs with a seed and a count.

`make attack` makes all of them and prints a table; `tests/test_attack.py` makes a few of each. An input is named by its
part, seed and number: the same three give the same input again.

parts: which there are; child: the process that takes inputs; pool: the processes that are told them, which notice a
crash or a hang; ledger: what is done, and the table; mutate, casting, writers: what several parts share.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

# Takes an input's source of chance and its number. Whether the input was accepted (else refused); raises what is wrong.
Attack = Callable[[np.random.Generator, int], bool]


class WrongError(Exception):
    """The input was taken, and what came of it is not right."""


class CrashError(Exception):
    """A process that the attack had started was ended by a signal that nobody had sent."""
