"""Camera keys of a film, read from a file: a time and a camera each. Errors name file and key."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

from .views import SceneView, View

NEEDED = ("time", "eye", "target")
KNOWN = (*NEEDED, "up", "fov")


def read_keys(file: Path, view: View | SceneView) -> list[tuple[float, Any]]:
    """Read the keyframes of an animation from a .toml or .json file: return time, in seconds, and Camera of each.

    view : camera of the command, from which size, lens, and missing up directions and fields of view are taken
    """
    from ..base.atomic_write import check_regular

    rows = _rows(check_regular(file))
    keys = []
    for number, row in enumerate(rows, 1):
        try:
            keys.append(_key(row, view))
            if number > 1 and keys[-1][0] <= keys[-2][0]:
                raise ValueError(f"time {keys[-1][0]:g} must be later than that of the previous key, {keys[-2][0]:g}")
        except (ValueError, OverflowError) as error:  # OverflowError: an integer of 400 digits
            raise ValueError(f"{file}: key {number}: {error}") from None
    if len(keys) < 2:
        raise ValueError(f"{file}: expected at least two keys, got {len(keys)}")
    return keys


def _rows(file: Path) -> list[Any]:
    """Read the list `keys` of a .toml or .json file, one dict per keyframe; ValueError if it is invalid."""
    kind = file.suffix.lower()
    if kind not in (".toml", ".json"):
        raise ValueError(f"{file}: keys must be .toml or .json, not {file.suffix or 'a file without extension'}")
    try:
        text = file.read_text(encoding="utf-8")
        data = tomllib.loads(text) if kind == ".toml" else json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{file}: not valid {kind[1:].upper()}: {error}") from None
    if not isinstance(data, dict) or set(data) != {"keys"} or not isinstance(data["keys"], list):
        example = "tables [[keys]]" if kind == ".toml" else 'a list, {"keys": [...]}'
        raise ValueError(f"{file}: the keys must be {example}, and nothing else")
    return data["keys"]


def _key(row: Any, view: View | SceneView) -> tuple[float, Any]:
    from ..base.arguments import check_number
    from ..rendering.camera import Camera

    if not isinstance(row, dict):
        raise ValueError(f"expected {', '.join(NEEDED)}, got {row!r}")
    unknown = [name for name in row if name not in KNOWN]
    if unknown:
        raise ValueError(f"unknown {unknown[0]!r}: a key has {', '.join(KNOWN)}")
    missing = [name for name in NEEDED if name not in row]
    if missing:
        raise ValueError(f"{missing[0]} is missing")
    lens = {**view.lens, "fov": row.get("fov", view.lens["fov"])}
    camera = Camera.look_at(row["eye"], row["target"], row.get("up", view.up), size=view.size, **lens)
    return check_number(row["time"], "time", "a finite number"), camera
