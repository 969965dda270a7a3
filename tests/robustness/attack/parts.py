"""The parts of the attack: how many inputs each has, and how long one may take."""

from __future__ import annotations

from typing import NamedTuple


class Part(NamedTuple):
    """One kind of attack.

    Attributes
    ----------
    module : str
        Its `begin(folder)` prepares the material of the inputs, and returns the `Attack`.
    count : int
        Inputs in a whole attack: 220,000 in all.
    few : int
        Inputs in `make test`.
    limit : float
        Seconds after which an input counts as a hang.
    checked : bool
        Whether kernels check every access to an array.
    """

    module: str
    count: int
    few: int
    limit: float
    checked: bool = False


PARTS = {
    "ply": Part("ply_files", 40_000, 300, 20.0),
    "points": Part("point_files", 18_000, 200, 5.0),
    "cache": Part("cache_files", 2_000, 40, 5.0),
    "pointray": Part("model_files", 50_000, 300, 20.0),
    "pointray-checked": Part("model_files", 50_000, 200, 20.0, checked=True),
    "toml": Part("scene_files", 30_000, 150, 30.0),
    "hdr": Part("sky_files", 8_200, 150, 20.0),
    "interrupts": Part("interrupts", 600, 12, 60.0),
    "commands": Part("commands", 200, 3, 60.0),
    "threads": Part("scenes_in_threads", 400, 6, 60.0),
    "disks": Part("disks", 400, 24, 60.0),
    "kills": Part("kills", 200, 10, 60.0),
    "arguments": Part("kernel_arguments", 20_000, 300, 5.0),
}
# All parts, and one that tests the harness itself.
KNOWN = {**PARTS, "sample": Part("sample", 0, 0, 2.5)}
