"""What `pointray` prints without arguments: five examples and the address of the manual."""

from __future__ import annotations

from ..base.manual import MANUAL
from ..base.version import __version__

EXAMPLES = {
    "pointray view scan.ply": "open a scan in the browser",
    "pointray render scan.ply -o scan.png": "render a picture of it",
    "pointray info scan.ply": "describe it and find problems",
    "pointray bake scan.ply -o lit.ply --colors": "bake light into its colours",
    "pointray prepare scan.ply -o scan.pointray": "save a model that opens quickly",
}


def greeting() -> str:
    """Return the text, of lines of at most 80 characters. Nothing heavy is imported: it appears at once."""
    width = max(map(len, EXAMPLES))
    return "\n".join(
        [
            f"pointray {__version__} ray traces point clouds. Examples:",
            "",
            *(f"  {command:{width}}  {text}" for command, text in EXAMPLES.items()),
            "",
            "No scan at hand: pointray demo. All commands: pointray --help",
            f"Manual: {MANUAL}",
        ]
    )
