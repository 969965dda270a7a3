"""A screenshot of the page that `pointray view` opens, for pages that show it as `viewer.webp`."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

SIZE = (1120, 700)  # pixels of the window
LIMIT = 240_000  # milliseconds until the picture is finished
FLAGS = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-background-networking")
FINISHED = "window.pointray && pointray.last && pointray.last.stage === 'refined' && pointray.last.samples >= 64"


def take(arguments: list[str], path: Path) -> None:
    """Run `pointray view` with these arguments, wait for the finished picture, and save a screenshot.

    Raises ImportError if playwright or Debian's chromium is not installed.
    """
    from playwright.sync_api import sync_playwright

    program = shutil.which("chromium")
    if program is None:
        raise ImportError("chromium is not installed")
    command = [sys.executable, "-m", "pointray", "view", "--no-open", *arguments]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as viewer, sync_playwright() as play:
        try:
            assert viewer.stderr is not None
            lines = iter(viewer.stderr.readline, "")
            url = next(found.group() for line in lines if (found := re.search(r"http://\S+/", line)))
            browser = play.chromium.launch(executable_path=program, args=list(FLAGS))
            size = {"width": SIZE[0], "height": SIZE[1]}
            page = browser.new_page(viewport=size, bypass_csp=True)  # type: ignore[arg-type]
            page.goto(url)
            page.wait_for_function(FINISHED, timeout=LIMIT)
            page.screenshot(path=path)
            browser.close()
        finally:
            viewer.terminate()
