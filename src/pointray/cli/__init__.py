"""A command line -> pictures, films, tables: `main`, and what a run's end means to the shell.

commands, options : the commands, and the options that several share
scan_scene, scene_file, views, keys : from a scan or a scene file to a scene and cameras
outputs, animate : `render` and `animate`; prepare, report (`info`), demo, serve (`view`), benchmark (`bench`)
waiting : the bar, and Ctrl-C

Begin with commands.
"""

from __future__ import annotations

import errno
import os
import sys
import warnings
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

DONE, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
# What a lack of memory is called by those who have no MemoryError: C++, threads, and what loads libraries.
NO_MEMORY = ("bad_alloc", "start new thread", "failed to map segment", "annot allocate memory")
FULL = {getattr(errno, name, None) for name in ("ENOSPC", "EDQUOT", "EFBIG")} - {None}  # the disk: no input is wrong


def execute(arguments: Sequence[str]) -> int:
    """Run a command; returns the exit status: 0, 1 (failed), 2 (bad input), 130 (interrupted)."""
    with warnings.catch_warnings():
        warnings.showwarning = _note  # type: ignore[assignment]
        warnings.simplefilter("default", UserWarning)
        try:
            from .commands import app

            return app(list(arguments), prog_name="pointray", standalone_mode=False) or DONE
        except KeyboardInterrupt:
            return INTERRUPTED
        except Exception as error:
            return _tell(error)


def _tell(error: Exception) -> int:
    """Say in one line what went wrong."""
    status = getattr(error, "exit_code", None)  # of typer's own errors
    if type(error).__name__ == "NoArgsIsHelpError":
        print(error)
        return BAD_INPUT
    if status is not None:
        _say(error.format_message() if hasattr(error, "format_message") else str(error))
        return int(status)
    if _lacks_memory(error):
        _say(f"not enough memory ({' '.join(f'{type(error).__name__}: {error}'.split()).rstrip(': ')})")
        return FAILED
    if isinstance(error, OSError | ValueError):
        _say(_reason(error))
        return FAILED if isinstance(error, OSError) and error.errno in FULL else BAD_INPUT
    _say(str(error) if type(error).__name__ == "WriteError" else f"{type(error).__name__}: {error}")
    return FAILED


def _lacks_memory(error: BaseException | None) -> bool:
    """Whether it, or what it comes from, is a lack of memory."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        if isinstance(error, MemoryError) or getattr(error, "errno", None) == errno.ENOMEM:
            return True
        if any(sign in str(error) for sign in NO_MEMORY):
            return True
        error = error.__cause__ or error.__context__
    return False


def _reason(error: OSError | ValueError) -> str:
    """The message; of the system's errors the file and the reason."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error)


def _say(text: str) -> None:
    print(f"pointray: {' '.join(text.split())}", file=sys.stderr)


def _note(message: Any, *rest: Any) -> None:
    """A warning of the library as one line."""
    _say(f"note: {message}")


def main() -> None:
    """What the shell starts."""
    try:
        status = execute(sys.argv[1:])
    except KeyboardInterrupt:  # a second one
        status = INTERRUPTED
    try:
        sys.stdout.flush()
    except (BrokenPipeError, ValueError, AttributeError):  # whoever read it has gone, or it is closed
        pass
    except OSError as error:
        if status == DONE:  # else it has been said
            status = FAILED
            _say(f"standard output: {error.strerror}")
    with suppress(OSError, ValueError, AttributeError):
        sys.stderr.flush()
    # A thread may still be inside of the compiler, which nothing interrupts: do not wait for it.
    os._exit(status)
