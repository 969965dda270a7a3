"""Look at the documentation site in a browser: screenshots, and accessibility by axe-core.

    python -m bench.looks.site_pages [--screenshots FOLDER] [--pages tutorial.html ...]

Needs the site (`make docs`) and Debian's chromium. Opens pages at the widths of a desk and a phone, in both themes.
Ends with status 1 if axe-core has serious or critical findings, a page is wider than the window, or search finds
nothing.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import http.server
import shutil
import sys
import threading
from pathlib import Path
from typing import Any

from docs.site.__main__ import HTML

PAGES = (
    "index.html",
    "install.html",
    "tutorial.html",
    "guides/index.html",
    "guides/rays.html",
    "concepts/surface.html",
    "gallery.html",
    "reference/commands.html",
    "reference/api/scenes.html",
    "troubleshooting.html",
)
LOOKS = (1280, "light"), (1280, "dark"), (400, "light")  # width in pixels, theme
FLAGS = ("--no-sandbox", "--disable-background-networking")
SERIOUS = "serious", "critical"


class QuietHandler(http.server.SimpleHTTPRequestHandler):
    """Serves a folder without printing requests."""

    def log_message(self, *_: Any) -> None:
        """Print nothing."""

    def copyfile(self, source: Any, outputfile: Any) -> None:
        """Send a file, unless the browser has left the page."""
        with contextlib.suppress(ConnectionError):
            super().copyfile(source, outputfile)


def findings(page: Any) -> list[str]:
    """Return the serious findings of axe-core on an open page, and whether it is too wide."""
    from axe_playwright_python.sync_playwright import Axe

    found = []
    for violation in Axe().run(page).response["violations"]:
        if violation["impact"] in SERIOUS:
            targets = [str(node["target"][0]) for node in violation["nodes"][:4]]
            found.append(f"{violation['impact']}: {violation['help']}: {', '.join(targets)}")
    wide = page.evaluate("document.documentElement.scrollWidth - window.innerWidth")
    return [*found, f"{wide} pixels wider than the window"] if wide > 1 else found


def look(browser: Any, address: str, pages: list[str], folder: Path | None) -> list[str]:
    """Open all pages at all widths and in both themes; return the findings."""
    found: list[str] = []
    for width, theme in LOOKS:
        page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=theme)
        requests: list[str] = []
        page.on("request", lambda request, seen=requests: seen.append(request.url))
        for name in pages:
            page.goto(f"{address}/{name}", wait_until="load")
            found += [f"{name}, {width} px, {theme}: {text}" for text in findings(page)]
            if folder is not None:
                page.screenshot(path=folder / f"{name.replace('/', '_')[:-5]}_{width}_{theme}.png", full_page=True)
        found += [f"{url}: from the network" for url in set(requests) if not url.startswith((address, "data:"))]
        page.close()
    return found


def search(browser: Any, address: str, word: str) -> list[str]:
    """Search for a word; return a finding if there is no result."""
    page = browser.new_page()
    page.goto(f"{address}/search.html?q={word}")
    try:
        page.wait_for_selector("#search-results li a", timeout=30_000)
    except Exception:
        return [f"search: nothing found for {word!r}"]
    return []


def main() -> int:
    """Run the checks; return the exit status."""
    from playwright.sync_api import sync_playwright

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--screenshots", type=Path)
    parser.add_argument("--pages", nargs="+", default=list(PAGES))
    chosen = parser.parse_args()
    if chosen.screenshots:
        chosen.screenshots.mkdir(parents=True, exist_ok=True)
    handler = functools.partial(QuietHandler, directory=str(HTML))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server, sync_playwright() as play:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}"
        browser = play.chromium.launch(executable_path=shutil.which("chromium"), args=list(FLAGS))
        found = look(browser, address, chosen.pages, chosen.screenshots) + search(browser, address, "radii")
        browser.close()
        server.shutdown()
    print(*found, f"{len(chosen.pages)} pages, {len(found)} findings", sep="\n")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
