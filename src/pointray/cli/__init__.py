"""The command line: `main`, and the exit status of a run.

commands : the commands, one file for each group; declare : options as fields of dataclasses
picture_options, read_options : the options of pictures and of reading, each declared once; options : parsers
scan_files : the files of a scan
scan_scene, scan_surface, scan_material, scan_lights : the scene of a scan
scene_file, views, keys : scene files, cameras, and keyframes of films
outputs, animate : the work of `render` and `animate`
baked_light, bake : sources of baked light, and the work of `bake`
prepare, convert, demo, serve, benchmark : the work of `prepare`, `convert`, `demo`, `view` and `bench`
facts, report, tables : the work of `info`; system, problems : that of `info --system`
greeting : `pointray` without arguments
waiting : progress bars and Ctrl-C; printable : texts without control characters; cluster : Dask workers
__main__ : `python -m pointray.cli`

Begin with commands.
"""

from __future__ import annotations

import errno
import os
import re
import sys
import warnings
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from ..base.manual import REPORT, address_of, page_about
from ..base.memory import FULL_DISK
from .printable import printable

DONE, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
# Signs of a lack of memory in errors other than MemoryError: from C++, threads, and the loader of libraries.
NO_MEMORY_SIGNS = ("bad_alloc", "start new thread", "failed to map segment", "annot allocate memory")


def execute(arguments: Sequence[str]) -> int:
    """Run a command given as command-line arguments, and print errors and warnings in one line each.

    Without arguments, print examples.

    Returns
    -------
    int
        Exit status: 0, 1 (failed), 2 (bad input), 130 (interrupted).
    """
    if not arguments:
        from .greeting import greeting

        print(greeting())
        return DONE
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
    """Return whether an error, or one that caused it, is a KeyboardInterrupt (Ctrl-C).

    Python raises a RuntimeError instead if Ctrl-C comes while a class is being created, or if it lets a lock of
    `threading` be released twice.
    """
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        if isinstance(error, KeyboardInterrupt):
            return True
        seen.add(id(error))
        error = error.__cause__ or error.__context__
    return False


def _report(error: Exception) -> int:
    """Print an error in one line and return the exit status of the command: 1 (failed) or 2 (bad input)."""
    status = getattr(error, "exit_code", None)  # typer's own errors have one
    if status is not None:
        _print(_usage(error))
        return int(status)
    if _lacks_memory(error):
        _explain(f"not enough memory ({' '.join(f'{type(error).__name__}: {error}'.split()).rstrip(': ')})")
        return FAILED
    if isinstance(error, OSError | ValueError):
        _explain(_reason(error))
        # A full disk is not bad input.
        return FAILED if isinstance(error, OSError) and error.errno in FULL_DISK else BAD_INPUT
    if type(error).__name__ == "WriteError":
        _print(str(error))
    else:
        _print(f"{type(error).__name__}: {error}; see {address_of(REPORT)}")
    return FAILED


def _lacks_memory(error: BaseException | None) -> bool:
    """Return whether an error, or one that caused it, is due to a lack of memory."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        if isinstance(error, MemoryError) or getattr(error, "errno", None) == errno.ENOMEM:
            return True
        if any(sign in str(error) for sign in NO_MEMORY_SIGNS):
            return True
        error = error.__cause__ or error.__context__
    return False


def _usage(error: Any) -> str:
    """Return the message of an error of Typer, with the most similar option if one is misspelt."""
    from ..base.spelling import did_you_mean

    if hasattr(error, "possibilities"):
        return f"{error.message}{did_you_mean(error.option_name, error.possibilities or ())}"
    return str(error.format_message() if hasattr(error, "format_message") else error)


def _reason(error: OSError | ValueError) -> str:
    """Return the message of an error, with the most similar name if a file or an attribute of points is misspelt."""
    from ..base.spelling import did_you_mean, suggest_file

    if isinstance(error, OSError) and error.strerror:
        if not error.filename:
            return error.strerror
        return f"{error.filename}: {error.strerror}{suggest_file(error)}"
    text = str(error)
    attribute = re.search(r"(?:no )?attribute '([^']+)'.*: ([^:]+)$", text)
    return f"{text}{did_you_mean(attribute[1], attribute[2].split(', '))}" if attribute else text


def _explain(text: str) -> None:
    """Print a message in one line, with the address of the manual's page about it if there is one."""
    page = page_about(text)
    _print(f"{text}; see {page}" if page else text)


def _print(text: str) -> None:
    print(f"pointray: {printable(' '.join(text.split()))}", file=sys.stderr)


def _note(message: Any, *rest: Any) -> None:
    """Print a warning of the package in one line, in place of `warnings.showwarning`. rest : not used"""
    _explain(f"note: {message}")


def main() -> None:
    """Run the program `pointray` with the arguments of this process, and exit without waiting for threads."""
    try:
        status = execute(sys.argv[1:])
    except KeyboardInterrupt:  # a second Ctrl-C
        status = INTERRUPTED
    try:
        sys.stdout.flush()
    except (BrokenPipeError, ValueError, AttributeError):  # the reader of the pipe is gone, or it is closed
        pass
    except OSError as error:
        if status == DONE:  # otherwise an error was printed
            status = FAILED
            _print(f"standard output: {error.strerror}")
    with suppress(OSError, ValueError, AttributeError):
        sys.stderr.flush()
    # Do not wait for threads: one may be in the compiler, which cannot be interrupted.
    os._exit(status)
