"""Run the code of one page: `python -m docs.site.run_page docs/guides/rays.md build/docs/runs/guides/rays`."""

from __future__ import annotations

import contextlib
import doctest
import glob
import io
import json
import os
import re
import shlex
import subprocess
import sys
import time
import tomllib
import traceback
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pointray as pr
from pointray.cli import execute

from .inputs import place_scans
from .pages import ROOT, Block, Page, load_page
from .pictures import compare, find_produced, store
from .screenshot import take

NOT_RUN = "pip", "make", "git", "cd"  # of installing: only checked
CLUSTER = "tcp://node1:8786"  # the address of a cluster on all pages
NUMBER = re.compile(r"\d[\d,.]*(?:e[+-]?\d+)?")


class PageError(Exception):
    """The code of a page does not do what the page shows."""


class PageRun:
    """Runs the blocks of a page in the current folder.

    absent : scans for which there are only stand-ins; outputs and pictures of blocks that use them are not compared
    problems : what is wrong, with lines of the page
    lacking : packages that are not installed; blocks that need them are not run
    """

    def __init__(self, page: Page, absent: set[str]) -> None:
        self.page, self.absent = page, absent
        self.problems: list[str] = []
        self.lacking: list[str] = []
        self._variables: dict[str, Any] = {"__name__": "__page__"}
        self._cluster: Any = None  # of Dask, which stands for the one of the pages

    def run(self) -> None:
        """Run all blocks, then compare the pictures."""
        steps: dict[str, Callable[[str], None]] = {"sh": self._shell, "python": self._python, "toml": _write_toml}
        for block in self.page.blocks:
            if block.language == "python" and self.lacking:
                continue  # it may need variables of a block that was not run
            printed = io.StringIO()  # output and notes
            output = _Tee(printed)
            try:
                with contextlib.redirect_stdout(output), contextlib.redirect_stderr(printed):
                    steps[block.language](self._with_cluster(block.text))
                if block.output is not None and self._is_real(block.text):
                    check_output(block.output, output.getvalue(), printed.getvalue())
            except ImportError as error:
                self.lacking.append(str(error))
            except (Exception, SystemExit) as error:
                self._report(block, error, printed.getvalue())

    def check_pictures(self, folder: Path, accept: bool) -> None:
        """Compare the pictures in a folder with the stored ones, or store them, if the scans are the real ones."""
        code = "".join(block.text for block in self.page.blocks)
        for stored in self.page.pictures:
            produced = find_produced(folder, stored.stem)
            loosely = bool(self.page.quick) or self.page.varies or stored.stem == "viewer"
            writes = (block.text for block in self.page.blocks if f"{stored.stem}." in block.text)
            real = self._is_real(next(writes, code))
            if produced is None:
                if not self.lacking:
                    self.problems.append(f"{self.page.name}: no block writes {stored.stem}.png")
            elif accept and real:
                store(produced, stored)
            elif not stored.exists() or real:
                difference = compare(produced, stored, loosely)
                self.problems += [f"{self.page.name}: {difference}"] if difference else []

    def _is_real(self, code: str) -> bool:
        """Return whether a block reads only real scans: it names one and no other, or the page has no others."""
        present = self.page.scans.keys() - self.absent
        return not self.absent or (any(x in code for x in present) and not any(x in code for x in self.absent))

    def _with_cluster(self, text: str) -> str:
        """Return a block with the address of a cluster that exists, which is started when it is first named."""
        if CLUSTER in text and self._cluster is None:
            from distributed import LocalCluster

            self._cluster = LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None)
        return text.replace(CLUSTER, self._cluster.scheduler_address) if self._cluster else text

    def _report(self, block: Block, error: BaseException, printed: str) -> None:
        text = str(error) if isinstance(error, PageError) else "".join(traceback.format_exception(error)[-3:])
        self.problems.append(f"{self.page.name}, line {block.line}: {text.strip()}\n{printed[-1500:]}")

    def _python(self, text: str) -> None:
        exec(compile(text, str(self.page.path), "exec"), self._variables)

    def _shell(self, text: str) -> None:
        for line in text.replace("\\\n", " ").splitlines():
            words = [path for word in shlex.split(line, comments=True) for path in _expand(word)]
            if not words:
                continue
            if words[0] == "pointray":
                self._command(words[1:])
            elif words[0] == "python":
                words += shlex.split(str(self.page.quick.get("python", "")))
                done = subprocess.run([sys.executable, *words[1:]], capture_output=True, text=True)
                print(done.stdout, done.stderr, sep="")
                if done.returncode:
                    raise PageError(f"exit status {done.returncode}: {line}")
            elif words[0] in NOT_RUN:
                check_installing(words)
            else:
                raise PageError(f"cannot run {line!r}: use a console or text block")

    def _command(self, arguments: list[str]) -> None:
        if arguments[:1] == ["view"]:  # tests/integration/test_pages.py opens all of them
            if any(picture.stem == "viewer" for picture in self.page.pictures) and not Path("viewer.png").exists():
                take(arguments[1:], Path("viewer.png"))
            return
        if arguments[0] in ("render", "animate"):
            for option, value in self.page.quick.items():
                if option in arguments:
                    place = arguments.index(option) + 1
                    arguments[place] = _narrow(arguments[place], value) if option == "--size" else str(value)
                elif option == "--size" and not any(word.startswith("--size=") for word in arguments):
                    arguments += [option, _narrow("4x3", value)]
        if status := execute(arguments):
            raise PageError(f"exit status {status}: pointray {shlex.join(arguments)}")


def _expand(word: str) -> list[str]:
    """Return the files of a pattern, as a shell does."""
    return sorted(glob.glob(word)) or [word] if "*" in word else [word]


def _narrow(size: str, width: int) -> str:
    """Return an image size, such as 1600x1200, with another width and the same aspect ratio."""
    w, h = map(int, size.split("x"))
    return f"{width}x{round(width * h / w)}"


class _Tee(io.StringIO):
    """A text that is written to another one too."""

    def __init__(self, other: io.StringIO) -> None:
        super().__init__()
        self._other = other

    def write(self, text: str) -> int:
        """Write a text to both."""
        self._other.write(text)
        return super().write(text)


def check_output(wanted: str, *printed: str) -> None:
    """Raise an error if a page shows none of the printed texts; numbers are not compared, `...` is any text."""
    masked = [NUMBER.sub("#", " ".join(text.split())) for text in (wanted.replace("...", "<more>"), *printed)]
    words, check = masked[0].replace("<more>", "..."), doctest.OutputChecker().check_output
    if not any(check(words, text, doctest.ELLIPSIS) for text in masked[1:]):
        raise PageError(f"the page shows other output:\n{wanted}\nprinted:")


def check_installing(words: list[str]) -> None:
    """Raise an error if an extra of `pip install` or a target of `make` does not exist."""
    if words[0] == "make":
        targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
        unknown = {word for word in words[1:] if "=" not in word} - set(targets)
    else:
        project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
        named = re.findall(r"\[([\w,]+)\]", " ".join(words)) if words[0] == "pip" else []
        unknown = {extra for names in named for extra in names.split(",")} - set(project["optional-dependencies"])
    if unknown:
        raise PageError(f"{' '.join(words)}: {', '.join(sorted(unknown))} does not exist")


def _write_toml(text: str) -> None:
    """Write a TOML block to the file that its first line names, `# scene.toml`; others are only checked."""
    tomllib.loads(text)
    if named := re.match(r"# *([\w./-]+\.toml)\b", text):
        Path(named[1]).write_text(text)


def _view_without_waiting(*arguments: Any, **options: Any) -> None:
    """Open a viewer as a page does, without a browser, and close it."""
    VIEW(*arguments, **{**options, "open_browser": False, "block": False}).close()


VIEW = pr.view


def run_page(path: Path, folder: Path, accept: bool = False) -> dict[str, Any]:
    """Run a page in an empty folder, which becomes the current one; return what happened."""
    start = time.perf_counter()
    page = load_page(path.resolve())
    page = replace(page, quick={}) if accept else page
    absent = place_scans(page, folder)
    os.chdir(folder)
    pr.view = _view_without_waiting
    run = PageRun(page, absent)
    run.run()
    run.check_pictures(folder, accept)
    seconds = round(time.perf_counter() - start, 1)
    return {"absent": sorted(absent), "problems": run.problems, "lacking": run.lacking, "seconds": seconds}


if __name__ == "__main__":
    target = Path(sys.argv[2]).resolve()
    target.mkdir(parents=True)
    result = run_page(Path(sys.argv[1]), target, "--accept" in sys.argv)
    (target / "result.json").write_text(json.dumps(result))
