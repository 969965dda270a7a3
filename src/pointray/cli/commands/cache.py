"""The command about the cache of models: `cache`."""

from __future__ import annotations

import time
from typing import Annotated

import typer


def cache(
    info: Annotated[bool, typer.Option("--info", help="What is kept, the default.")] = False,
    clear: Annotated[bool, typer.Option("--clear", help="Remove all of it.")] = False,
    json: Annotated[bool, typer.Option("--json", help="As JSON.")] = False,
) -> None:
    """Models of scans that were built before, which view, render and animate take the next time."""
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
