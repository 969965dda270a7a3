"""Child processes that take inputs in batches. How a child ends distinguishes a crash from a refusal."""

from __future__ import annotations

import json
import os
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from attack.parts import KNOWN

ALONE = 20  # crashes and hangs that are repeated alone; later ones are only counted
START = 1800.0  # seconds for a child to be ready, which may compile kernels
ATTACKS = Path(__file__).resolve().parents[1]
TESTS = ATTACKS.parent


@dataclass
class Failure:
    """An input that was neither accepted nor refused.

    Attributes
    ----------
    kind : str
        crashed, hung or failed.
    again : bool
        Whether the input fails the same way alone in a new process.
    """

    index: int
    kind: str
    what: str
    again: bool


@dataclass
class Tally:
    """Outcomes of some inputs."""

    counts: Counter[str] = field(default_factory=Counter)
    failures: list[Failure] = field(default_factory=list)


class HangError(Exception):
    """No answer in time."""


class Child:
    """A process that takes the inputs of one part and seed."""

    def __init__(self, part: str, seed: int) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="pointray-attack-"))
        self._errors = self.folder / "stderr"
        inputs = self.folder / "inputs"
        inputs.mkdir()
        paths = [str(TESTS), str(ATTACKS), *filter(None, [os.environ.get("PYTHONPATH")])]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "POINTRAY_THREADS": "2"}
        environment["POINTRAY_CHECK"] = "1" if KNOWN[part].checked else os.environ.get("POINTRAY_CHECK", "")
        command = [sys.executable, "-m", "attack.child", part, str(seed), str(inputs)]
        with self._errors.open("wb") as errors:
            # In its own process group: Ctrl-C reaches only the parent, and the child's own children end with it.
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                env=environment,
                start_new_session=True,
            )
        self._limit, self._rest = KNOWN[part].limit, b""
        if not self._next(START):
            words = self.last_words()
            self.end()
            raise RuntimeError(f"the part {part} does not begin: {words}")

    def answers(self, start: int, stop: int) -> Iterator[dict[str, Any]]:
        """The outcomes of the inputs, fewer than asked for if the child dies. HangError if one takes too long."""
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):
            self._process.stdin.write(f"{start} {stop}\n".encode())
            self._process.stdin.flush()
        for _ in range(start, stop):
            answer = self._next(self._limit)
            if answer is None:
                return
            yield answer

    def _next(self, limit: float) -> dict[str, Any] | None:
        """The next line, or None at the end."""
        assert self._process.stdout is not None
        pipe, end = self._process.stdout.fileno(), time.monotonic() + limit
        while b"\n" not in self._rest:
            if not select.select([pipe], [], [], max(end - time.monotonic(), 0.0))[0]:
                raise HangError
            data = os.read(pipe, 1 << 16)
            if not data:
                return None
            self._rest += data
        line, _, self._rest = self._rest.partition(b"\n")
        answer: dict[str, Any] = json.loads(line)
        return answer

    def last_words(self) -> str:
        """How it ended, and where: the first line of Python's fault handler about the thread that crashed."""
        status = self._process.wait(30)
        name = signal.Signals(-status).name if status < 0 else f"exit status {status}"
        text = self._errors.read_text(errors="replace")
        lines = (text[text.find("Current thread") :] if "Current thread" in text else text).splitlines()
        at = [line.strip() for line in lines if line.startswith('  File "')]
        output = [line for line in lines if line and not line.startswith(" ")]
        return f"{name} {at[0] if at and status < 0 else ' / '.join(output[-2:])}"[:300]

    def end(self) -> None:
        """Kill it and all that it has started, and remove its folder."""
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with suppress(BrokenPipeError):
                    pipe.close()
        shutil.rmtree(self.folder, ignore_errors=True)


class Attacker:
    """Makes the inputs of one part in a child, and starts another child whenever an input ends it.

    Use it as a context manager, which ends the child.
    """

    def __init__(self, part: str, seed: int) -> None:
        self.part, self.seed = part, seed
        self._child: Child | None = None
        self._repeated = 0

    def __enter__(self) -> Attacker:
        return self

    def __exit__(self, *error: object) -> None:
        if self._child is not None:
            self._child.end()
            self._child = None

    def make(self, start: int, stop: int) -> Tally:
        """Make inputs. One that ends the child or takes too long is repeated alone."""
        tally, index = Tally(), start
        while index < stop:
            index = self._go_on(index, stop, tally)
        return tally

    def _go_on(self, start: int, stop: int, tally: Tally) -> int:
        """Make inputs until all are made or the child is gone; returns the first that remains."""
        if self._child is None:
            self._child = Child(self.part, self.seed)
        index, kind, what = start, "", ""
        try:
            for answer in self._child.answers(start, stop):
                index = answer["index"] + 1
                tally.counts[answer["outcome"]] += 1
                if answer["what"]:
                    tally.failures.append(Failure(answer["index"], answer["outcome"], answer["what"], True))
            if index < stop:
                kind, what = "crashed", self._child.last_words()
        except HangError:
            kind, what = "hung", f"longer than {KNOWN[self.part].limit:g} s"
        if not kind:
            return index
        self.__exit__()
        tally.counts[kind] += 1
        self._repeated += 1
        again = self._repeated <= ALONE and self._alone(index) == kind
        tally.failures.append(Failure(index, kind, what, again))
        return index + 1

    def _alone(self, index: int) -> str:
        """The outcome of an input in a new child."""
        child = Child(self.part, self.seed)
        try:
            answer = next(iter(child.answers(index, index + 1)), None)
            return "crashed" if answer is None else str(answer["outcome"])
        except HangError:
            return "hung"
        finally:
            child.end()
