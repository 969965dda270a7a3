"""The process that takes inputs: their numbers come in by stdin, their outcomes go out as lines of JSON.

    python -m attack.child PART SEED FOLDER

It lives on after a refusal and after a failure; a crash ends it, which its parent sees.
"""

from __future__ import annotations

import faulthandler
import json
import os
import sys
import traceback
import warnings
import zlib
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from attack import Attack, CrashError
from attack.parts import KNOWN

MEMORY = 8 << 30  # bytes of address space: no file may make the reader ask for more


def chance(part: str, seed: int, index: int) -> np.random.Generator:
    """The random generator of an input, which is the same for both parts that attack saved models."""
    return np.random.default_rng([zlib.crc32(KNOWN[part].module.encode()), seed, index])


def outcome_of(attack: Attack, rng: np.random.Generator, index: int, folder: Path) -> tuple[str, str]:
    """accepted, refused, crashed or failed; the last two with what happened, without the folder's name."""
    try:
        return ("accepted" if attack(rng, index) else "refused"), ""
    except CrashError as crash:
        return "crashed", str(crash)
    except Exception as error:
        frame = traceback.extract_tb(error.__traceback__)[-1]
        words = " ".join(str(error).replace(str(folder), "").split())[:300]
        return "failed", f"{type(error).__name__}: {words} ({Path(frame.filename).name})"


def limit_memory() -> None:
    """Limit the process's memory to less than the machine's, where the system allows."""
    try:
        import resource
    except ImportError:
        return
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def main() -> None:
    part, seed, folder = sys.argv[1], int(sys.argv[2]), Path(sys.argv[3])
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # answers must not mix with what the library prints
    faulthandler.enable()
    limit_memory()
    warnings.simplefilter("ignore")
    np.seterr(all="ignore")

    def answer(**fields: Any) -> None:
        print(json.dumps(fields), file=out, flush=True)

    attack = import_module(f"attack.{KNOWN[part].module}").begin(folder)
    answer(ready=True)
    for line in sys.stdin:
        start, stop = map(int, line.split())
        for index in range(start, stop):
            outcome, what = outcome_of(attack, chance(part, seed, index), index, folder)
            answer(index=index, outcome=outcome, what=what)


if __name__ == "__main__":
    main()
