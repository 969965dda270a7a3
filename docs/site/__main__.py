"""Build the site: run all pages, then Sphinx. `python -m docs.site [--accept] [--only NAME] [--pages]`"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from .pages import DOCS, ROOT, Page, all_pages
from .runs import run

HTML = ROOT / "build" / "docs" / "html"
PROCESSES = 1 + (os.cpu_count() or 1)  # that run pages; they wait for browsers, films and workers at times
LONGEST = "gallery"  # its page takes a quarter of the time, and is begun first


def run_pages(pages: list[Page], accept: bool) -> list[str]:
    """Run pages with a progress bar, the longest first; return the problems."""
    problems: list[str] = []
    pages = sorted(pages, key=lambda page: page.name != LONGEST)
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with Progress(*columns) as progress, ThreadPoolExecutor(PROCESSES) as pool:
        task = progress.add_task("pages", total=len(pages))
        for page, result in zip(pages, pool.map(lambda page: run(page, accept), pages), strict=True):
            notes = [f"without {name}" for name in result["absent"]] + result["lacking"]
            progress.console.print(f"{result['seconds']:6.1f} s  {page.name}", *notes, sep="  ", markup=False)
            problems += result["problems"]
            progress.advance(task)
    return problems


def main() -> int:
    """Build the site in `build/docs/html`; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--accept", action="store_true", help="store the pictures that pages produce")
    parser.add_argument("--only", default="", help="run only pages with this text in their names")
    parser.add_argument("--pages", action="store_true", help="do not call Sphinx")
    chosen = parser.parse_args()
    problems = run_pages([page for page in all_pages() if page.run and chosen.only in page.name], chosen.accept)
    print(*problems, sep="\n", file=sys.stderr)
    if problems or chosen.pages:
        return len(problems) > 0
    command = ["-W", "--keep-going", "-q", "-j", "auto", "-b", "html", str(DOCS), str(HTML)]
    status = subprocess.run([sys.executable, "-m", "sphinx", *command], cwd=ROOT).returncode
    print(f"{HTML / 'index.html'}" if status == 0 else "Sphinx failed")
    return status


if __name__ == "__main__":
    sys.exit(main())
