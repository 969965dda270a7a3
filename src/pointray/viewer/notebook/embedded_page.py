"""Module that shows the viewer's page in the frame of a widget, without a server."""

from __future__ import annotations

import json
import re
from pathlib import Path

from ..server import PAGE

WIDGET = Path(__file__).with_name("widget.js")
BANNER = re.compile(r'(<div id="banner"[^>]*>)[^<]*')
LOST = "Disconnected: the kernel has stopped or the widget was closed. Run the cell again."


def widget_module() -> str:
    """Return the JavaScript module of the widget: `widget.js` with the files of the page."""
    modules = {path.name: path.read_text("utf-8") for path in sorted(PAGE.glob("*.js"))}
    page = json.dumps({"html": page_html(), "modules": modules})
    return WIDGET.read_text("utf-8").replace("PAGE_OF_POINTRAY", page)


def page_html() -> str:
    """Return the page with its style sheets, but without its script, which the widget inserts."""
    html = (PAGE / "index.html").read_text("utf-8")
    html = re.sub(r"\s*<script [^>]*></script>", "", html)
    html = BANNER.sub(rf"\1{LOST}", html)

    def style(link: re.Match[str]) -> str:
        return f"<style>\n{(PAGE / link[1]).read_text('utf-8')}\n</style>"

    return re.sub(r'<link rel="stylesheet" href="([\w.-]+)" />', style, html)
