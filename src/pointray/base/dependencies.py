"""Source files that a module depends on, found by following its imports, and a hash of their contents.

Compiled kernels and cached models are stored under such hashes: editing a file invalidates exactly those that depend on
it. Imports are found with a regular expression, because parsing all files would take 0.4 s at each start.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]  # folder of the package
PACKAGE = ROOT.name

_NAMES = rb"(\((?:[^)#]|#[^\n]*)*\)|[^\n(#]+)"  # after `import`: one line, or lines in parentheses with comments
_FROM = re.compile(rb"^([ \t]*)from[ \t]+(\.*)([\w.]*)[ \t]+import[ \t]+" + _NAMES, re.MULTILINE)
_MODULE = rb"[\w.]+(?:[ \t]+as[ \t]+\w+)?"
_IMPORT = re.compile(rb"^([ \t]*)import[ \t]+(" + _MODULE + rb"(?:,[ \t]*" + _MODULE + rb")*)", re.MULTILINE)
_LATER = re.compile(rb"^LATER = (.*)", re.MULTILINE)  # modules of the same folder, see `jit.later`
_COMMENT = re.compile(rb"#[^\n]*")
_WORD = re.compile(rb"\w+")
_FIRST_WORD = re.compile(rb"(?:^|[(,])\s*(\w+)")


def files_of(roots: Iterable[Path], deferred: bool = False) -> list[Path]:
    """Find the Python source files that modules import, directly or indirectly, including the modules themselves.

    Parameters
    ----------
    roots : iterable of path
        Files of the modules. From modules of pointray, only imports of pointray's own modules are followed; from
        other files, also imports of files in their own folder.
    deferred : bool
        Also follow imports inside functions and other blocks; kernels depend only on those at module level.

    Returns
    -------
    list of path
        Sorted.
    """
    found: set[Path] = set()
    waiting = list(roots)
    while waiting:
        path = waiting.pop()
        if path not in found:
            found.add(path)
            waiting += _imports(path, deferred)
    return sorted(found)


def key_of(roots: Iterable[Path], deferred: bool = False) -> str:
    """Hash the source files that modules depend on, so that caches of their results are renewed when one is edited.

    The files are those of `files_of(roots, deferred)`: `roots`, and all files of pointray that these import.

    Returns
    -------
    str
        16 hexadecimal digits, from the names and contents of the files.
    """
    digest = hashlib.sha256()
    for path in files_of(roots, deferred):
        name = path.relative_to(ROOT).as_posix() if path.is_relative_to(ROOT) else path.name
        digest.update(f"{name}\0{digest_of(path)}\n".encode())
    return digest.hexdigest()[:16]


@cache
def digest_of(path: Path) -> str:
    """Return the SHA-256 of the contents of a file, in hexadecimal digits. Later changes of the file are not seen."""
    return hashlib.sha256(_text(path)).hexdigest()


@cache
def _text(path: Path) -> bytes:
    return path.read_bytes()


@cache
def _imports(path: Path, deferred: bool) -> frozenset[Path]:
    """Return the source files that a Python file imports directly, as far as they belong to pointray.

    From a file outside the package, imports of files in its own folder count too.

    deferred : whether imports inside functions and other blocks count
    """
    found: set[str] = set()
    own = path.is_relative_to(ROOT)
    for indent, dots, module, names in _FROM.findall(_text(path)):
        base = _base(path, own, len(dots), module.decode()) if deferred or not indent else None
        if base:
            words = {word.decode() for word in _FIRST_WORD.findall(_COMMENT.sub(b"", names))}
            found.update(file for target in (base, *_below(base, words)) for file in _files_at(target))
    for indent, modules in _IMPORT.findall(_text(path)):
        for module in modules.decode().split(",") if deferred or not indent else ():
            base = _base(path, own, 0, module.split()[0])
            found.update(_files_at(base) if base else ())
    for names in _LATER.findall(_text(path)):
        for name in _WORD.findall(names):
            found.update(_files_at(os.path.join(path.parent, name.decode())))
    return frozenset(map(Path, found))


def _base(path: Path, own: bool, level: int, module: str) -> str | None:
    """Return the path, without extension, of the module named in an import statement of a Python file.

    An absolute import of another package gives None in files of pointray, and a path beside the file in others.

    path : the file; own : whether the file belongs to pointray; level : leading dots before `module`
    """
    parts = module.split(".")
    if level:
        return os.path.join(path.parents[level - 1], *parts)
    if parts[0] == PACKAGE:
        return os.path.join(ROOT, *parts[1:])
    return None if own else os.path.join(path.parent, *parts)


def _below(base: str, names: set[str]) -> list[str]:
    """Return the paths, without extension, of imported names that are modules, as in `from package import module`.

    base : path of the package; names : imported names, which may also be functions or classes
    """
    known = _listing(base.rstrip(os.sep))
    return [os.path.join(base, name) for name in names if name in known or f"{name}.py" in known]


def _files_at(base: str) -> list[str]:
    """Return the source file of the module or package at a path without extension, as a list; empty if missing."""
    base = base.rstrip(os.sep)
    folder, name = os.path.split(base)
    files = [f"{base}.py"] if f"{name}.py" in _listing(folder) else []
    return [os.path.join(base, "__init__.py")] if "__init__.py" in _listing(base) else files


@cache
def _listing(folder: str) -> frozenset[str]:
    """Return the names of the files in a folder, cached by folder; empty if it does not exist."""
    try:
        return frozenset(os.listdir(folder))
    except OSError:
        return frozenset()
