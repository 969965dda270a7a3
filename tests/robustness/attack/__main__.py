"""python -m attack: all parts or one, resumed where the last call stopped; then the table."""

from __future__ import annotations

import argparse
import os
import queue
import signal
import sys
import threading
import time
from pathlib import Path

from attack.ledger import Ledger, code_key
from attack.parts import PARTS
from attack.pool import Attacker

BATCHES = 200  # batches into which the inputs of a part are cut
REPORT_INTERVAL = 15.0  # seconds between two messages of progress


def spans_of(count: int) -> list[tuple[int, int]]:
    """Batches of inputs. Their length is a power of two, so that a larger count shares most of them."""
    length = 1
    while length * BATCHES < count:
        length *= 2
    return [(start, min(start + length, count)) for start in range(0, count, length)]


def attack_part(ledger: Ledger, part: str, seed: int, count: int, jobs: int) -> None:
    """Make the remaining inputs of a part, in several processes at once."""
    left: queue.SimpleQueue[tuple[int, int]] = queue.SimpleQueue()
    for span in spans_of(count):
        if not ledger.has(part, seed, *span):
            left.put(span)
    if left.empty():
        return
    stopped, errors, lock = threading.Event(), [], threading.Lock()

    def work() -> None:
        try:
            with Attacker(part, seed) as attacker:
                while not stopped.is_set():
                    span = left.get_nowait()
                    begun = time.monotonic()
                    tally = attacker.make(*span)
                    with lock:
                        ledger.keep(part, seed, span, tally, time.monotonic() - begun)
        except queue.Empty:
            pass
        except BaseException as error:
            errors.append(error)
            stopped.set()

    workers = [threading.Thread(target=work) for _ in range(min(jobs, left.qsize()))]
    for worker in workers:
        worker.start()
    try:
        output = time.monotonic()
        while any(worker.is_alive() for worker in workers):
            time.sleep(0.1)
            if time.monotonic() - output > REPORT_INTERVAL:
                output = time.monotonic()
                counts = ledger.of(part, seed)[0].counts
                bad = counts["crashed"] + counts["hung"] + counts["failed"]
                print(f"{part}: {counts['inputs']:,} of {count:,} inputs, {bad:,} failures", file=sys.stderr)
    except KeyboardInterrupt:
        print("stopping: what is begun is finished; the same command goes on from here", file=sys.stderr)
        stopped.set()
        raise
    finally:
        for worker in workers:
            worker.join()
    if errors:
        raise errors[0]


def show_input(part: str, seed: int, index: int) -> int:
    """Make one input in its own child process and print the outcome."""
    with Attacker(part, seed) as attacker:
        tally = attacker.make(index, index + 1)
    for failure in tally.failures:
        print(f"{failure.kind}: {failure.what}{'' if failure.again else ' (not when made again)'}")
    print(", ".join(tally.counts))
    return int(bool(tally.failures))


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m attack", description=__doc__)
    parser.add_argument("part", nargs="*", help=f"of {', '.join(PARTS)}; default: all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, help="inputs of each part; default: 200,000 in all")
    parser.add_argument("--input", type=int, help="one input alone: its number")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes at once")
    parser.add_argument("--state", type=Path, default=Path(".attack"), help="where it is noted what is done")
    options = parser.parse_args()
    unknown = [part for part in options.part if part not in PARTS]
    if unknown:
        parser.error(f"unknown part {unknown[0]}: one of {', '.join(PARTS)}")
    parts = options.part or list(PARTS)
    # A background job of a shell ignores Ctrl-C, and so does all that it starts: no interrupt would arrive.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if options.input is not None:
        if len(parts) != 1:
            parser.error("--input is for one part")
        return show_input(parts[0], options.seed, options.input)
    ledger = Ledger(options.state, code_key())
    try:
        for part in parts:
            count = PARTS[part].count if options.count is None else options.count
            attack_part(ledger, part, options.seed, count, options.jobs)
    except KeyboardInterrupt:
        return 130
    finally:
        print(ledger.table(parts, options.seed))
    bad = [failure for part in parts for failure in ledger.of(part, options.seed)[0].failures]
    return int(bool(bad))


if __name__ == "__main__":
    sys.exit(main())
