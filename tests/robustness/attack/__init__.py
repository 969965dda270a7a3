"""Attacks: mutated files, interrupts, threads, full disks and kills, as programs with a seed and a count.

`make attack` makes all of them and prints a table; `tests/robustness/test_attack.py` makes a few of each. An input is
named by its part, seed and number: the same three give the same input again.

`parts` lists the parts. `child` is the process that takes inputs, `pool` the processes that send them and notice a
crash or a hang. `ledger` records what is done and prints the table. Several parts share `mutate`, `casting` and
`writers`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

# Takes an input's random generator and number. Returns whether the input was accepted; raises if anything is wrong.
Attack = Callable[[np.random.Generator, int], bool]


class WrongError(Exception):
    """The input was accepted, and its result is wrong."""


class CrashError(Exception):
    """A process of the attack was ended by a signal that nobody had sent."""
