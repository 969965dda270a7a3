"""The command `cache`, for the cache of models."""

from __future__ import annotations

import time
from typing import Annotated

from ..declare import OUTPUT, single, with_options


@with_options("pointray cache", "pointray cache --clear")
def cache(
    info: Annotated[bool, single(OUTPUT, None, "List the stored models (default).", "--info")] = False,
    clear: Annotated[bool, single(OUTPUT, None, "Remove all stored models.", "--clear")] = False,
    json: Annotated[bool, single(OUTPUT, None, "Print JSON.", "--json")] = False,
) -> None:
    """List or clear the cache of models, from which view, render and animate start faster."""
    from ...model import model_cache
    from ..tables import show_table

    if info and clear:
        raise ValueError("--info and --clear exclude each other")
    if clear:
        number, size = model_cache.clear()
        show_table({"folder": str(model_cache.folder()), "removed": number, "bytes": size}, json)
        return
    models = [
        {
            "files": [file["path"] for file in model.get("files", [])],
            "points": model.get("points"),
            "bytes": model["bytes"],
            "used": time.strftime("%Y-%m-%d %H:%M", time.localtime(model["used"])),
        }
        for model in model_cache.describe()
    ]
    total = sum(model["bytes"] for model in models)
    if json:
        show_table({"folder": str(model_cache.folder()), "bytes": total, "models": models}, json)
        return
    print(f"{model_cache.folder()}: {len(models)} models, {total / 2**20:,.0f} MiB")
    for model in models:
        more = f" and {len(model['files']) - 1:,} more" if len(model["files"]) > 1 else ""
        name = f"{model['files'][0]}{more}" if model["files"] else "?"
        print(f"  {model['bytes'] / 2**20:8,.0f} MiB  {model['points'] or 0:>12,} points  {model['used']}  {name}")
