"""Build hook for wheels: pure, or with the kernels of `python -m native` if `POINTRAY_WHEEL=linux-x86_64` is set."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class CustomBuildHook(BuildHookInterface):  # type: ignore[misc]
    """Adds the kernel libraries and the wheel tag of a platform."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        system = os.environ.get("POINTRAY_WHEEL", "")
        if not system or self.target_name != "wheel" or version == "editable":
            return
        sys.path.insert(0, self.root)
        from native.targets import SYSTEMS

        folder = Path(self.root, "build", "wheel", system)
        if not (folder / "manifest.json").exists():
            raise FileNotFoundError(f"{folder}: not built: run make wheel or make wheels")
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{SYSTEMS[system].wheel}"
        build_data["force_include"][str(folder)] = "pointray/engine/native"
