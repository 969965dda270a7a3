"""The command line: `main`, and the exit status of a run.

commands, options : the commands, a file for each group of them, and the options that several share
read_options, scan_files : which points of which files are read
scan_scene, scene_file, views, keys : from a scan or a scene file to a scene and cameras
outputs, animate : the work of `render` and `animate`
scan_lights : the lights of a scan, and whether they are baked
baked_light, bake : where pictures get baked light from, and the work of `bake`
prepare, convert, demo, serve, benchmark : the work of `prepare`, `convert`, `demo`, `view` and `bench`
facts, report, tables : the work of `info`: of files, coordinates and attributes, of points, and how they are shown
waiting : progress bars, and Ctrl-C; printable : texts from files, without control characters

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

from ..base.memory import FULL_DISK
from .printable import printable

DONE, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
# A lack of memory in messages of errors other than MemoryError: from C++, threads, and the loader of libraries.
NO_MEMORY_SIGNS = ("bad_alloc", "start new thread", "failed to map segment", "annot allocate memory")


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
            return INTERRUPTED if _is_interrupted(error) else _report(error)


def _is_interrupted(error: BaseException | None) -> bool:
    """Whether an error stands for a Ctrl-C, or was met while one was handled.

    Python turns one that meets a class while it is made into a RuntimeError, and one that meets a lock of `threading`
    may release it twice.
    """
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        if isinstance(error, KeyboardInterrupt):
            return True
        seen.add(id(error))
        error = error.__cause__ or error.__context__
    return False


def _report(error: Exception) -> int:
    """Print one line that tells what went wrong; returns the exit status."""
    status = getattr(error, "exit_code", None)  # typer's own errors have one
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
        # A full disk is no fault of the input.
        return FAILED if isinstance(error, OSError) and error.errno in FULL_DISK else BAD_INPUT
    _say(str(error) if type(error).__name__ == "WriteError" else f"{type(error).__name__}: {error}")
    return FAILED


def _lacks_memory(error: BaseException | None) -> bool:
    """Whether an error, or one that caused it, is a lack of memory."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        if isinstance(error, MemoryError) or getattr(error, "errno", None) == errno.ENOMEM:
            return True
        if any(sign in str(error) for sign in NO_MEMORY_SIGNS):
            return True
        error = error.__cause__ or error.__context__
    return False


def _reason(error: OSError | ValueError) -> str:
    """The message; for errors of the operating system the file and the reason."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error)


def _say(text: str) -> None:
    print(f"pointray: {printable(' '.join(text.split()))}", file=sys.stderr)


def _note(message: Any, *rest: Any) -> None:
    """Print a warning of the library as one line."""
    _say(f"note: {message}")


def main() -> None:
    """The entry point of the program `pointray`."""
    try:
        status = execute(sys.argv[1:])
    except KeyboardInterrupt:  # a second Ctrl-C
        status = INTERRUPTED
    try:
        sys.stdout.flush()
    except (BrokenPipeError, ValueError, AttributeError):  # its reader has gone, or it is closed
        pass
    except OSError as error:
        if status == DONE:  # otherwise an error has been reported
            status = FAILED
            _say(f"standard output: {error.strerror}")
    with suppress(OSError, ValueError, AttributeError):
        sys.stderr.flush()
    # Do not wait for threads: one may still be in the compiler, which cannot be interrupted.
    os._exit(status)
