"""The record of what is done, with which an interrupted attack goes on, and the table at its end."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from attack.pool import Failure, Tally

ROOT = Path(__file__).resolve().parents[3]
COLUMNS = ("inputs", "accepted", "refused", "crashed", "hung", "failed")
SHOWN = 8  # inputs of a failure that are listed


def code_key() -> str:
    """A hash of the package and of the attack. Batches that were done with another hash do not count."""
    digest = hashlib.sha256()
    for folder in ("src", "tests/helpers", "tests/robustness/attack"):
        files = [path for path in (ROOT / folder).rglob("*") if path.suffix in (".py", ".toml", ".txt")]
        for path in sorted(files):
            digest.update(path.relative_to(ROOT).as_posix().encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


class Ledger:
    """Batches that are done, one a line of a file that only grows.

    Parameters
    ----------
    folder : path
        It is created if absent.
    """

    def __init__(self, folder: Path, key: str) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._file = folder / f"{key}.jsonl"
        self._batches: dict[tuple[str, int, int], dict[str, Any]] = {}
        lines = self._file.read_text().splitlines() if self._file.exists() else []
        for line in lines:
            try:
                batch = json.loads(line)
                self._batches[batch["part"], batch["seed"], batch["start"]] = batch
            except (ValueError, KeyError):  # a line that was cut off when the machine stopped
                continue
        with self._file.open("a") as file:
            file.write("\n")  # ends such a line

    def has(self, part: str, seed: int, start: int, stop: int) -> bool:
        """Whether a batch is done."""
        batch = self._batches.get((part, seed, start))
        return batch is not None and batch["stop"] >= stop

    def keep(self, part: str, seed: int, span: tuple[int, int], tally: Tally, seconds: float) -> None:
        """Note that a batch is done."""
        start, stop = span
        batch = {"part": part, "seed": seed, "start": start, "stop": stop, "seconds": round(seconds, 3)}
        batch |= {"counts": dict(tally.counts), "failures": [asdict(failure) for failure in tally.failures]}
        self._batches[part, seed, start] = batch
        with self._file.open("a") as file:
            file.write(json.dumps(batch) + "\n")

    def of(self, part: str, seed: int) -> tuple[Tally, float]:
        """The outcomes of all inputs so far, and the seconds that they took."""
        tally, seconds = Tally(), 0.0
        for batch in self._batches.values():
            if (batch["part"], batch["seed"]) == (part, seed):
                tally.counts.update(batch["counts"])
                tally.counts["inputs"] += batch["stop"] - batch["start"]
                tally.failures += [Failure(**failure) for failure in batch["failures"]]
                seconds += batch["seconds"]
        return tally, seconds

    def table(self, parts: Iterable[str], seed: int) -> str:
        """Inputs and outcomes of each part, then each failure with the inputs that show it."""
        lines = [f"{'part':18}" + "".join(f"{name:>10}" for name in COLUMNS) + f"{'seconds':>10}"]
        total, failures, whole = Counter[str](), [], 0.0
        for part in parts:
            tally, seconds = self.of(part, seed)
            lines.append(f"{part:18}" + _cells(tally.counts) + f"{seconds:10,.0f}")
            total.update(tally.counts)
            whole += seconds
            failures += _grouped(part, seed, tally.failures)
        lines.append(f"{'all':18}" + _cells(total) + f"{whole:10,.0f}")
        return "\n".join([*lines, "", *(failures or ["no crash, no hang, no failure"])])


def _cells(counts: Counter[str]) -> str:
    return "".join(f"{counts[name]:10,}" for name in COLUMNS)


def _grouped(part: str, seed: int, failures: list[Failure]) -> list[str]:
    """A line for each kind of failure: how often it came, and its inputs, named as `make attack` takes them."""
    groups: dict[tuple[str, str], list[Failure]] = {}
    for failure in sorted(failures, key=lambda failure: failure.index):
        same = "".join("#" if letter.isdigit() else letter for letter in failure.what[:80])
        groups.setdefault((failure.kind, same), []).append(failure)
    lines = []
    for (kind, _), group in groups.items():
        numbers = " ".join(f"{failure.index}{'' if failure.again else '?'}" for failure in group[:SHOWN])
        more = f" and {len(group) - SHOWN} more" if len(group) > SHOWN else ""
        lines.append(f"{kind} {len(group)} x: {group[0].what}\n    PART={part} SEED={seed} INPUT={numbers}{more}")
    return lines
