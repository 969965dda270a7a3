"""Scene files: a whole scene as TOML, in the words of the Python classes and parameters.

source, lines : the text, and the line on which each key stands
words : the keys that a table may have, from the signatures of Python classes and functions
shading, models, instances, light : the parts of a scene, first checked and then made
plan : the whole file

Begin with plan.
"""

from __future__ import annotations

import os
from collections.abc import Callable

from ..base.arguments import check_callback, check_path
from .plan import Plan, SceneFile

__all__ = ["Plan", "SceneFile", "load_scene"]


def load_scene(path: str | os.PathLike[str], progress: Callable[[str, float], None] | None = None) -> SceneFile:
    """Make the scene that a TOML file describes.

    The file is checked completely before any file that it names is read.

    Parameters
    ----------
    path : str or path
        Paths within the file are relative to its folder.
    progress : callable, optional
        Called with a stage's name and the share done.

    Returns
    -------
    SceneFile
        scene, camera, settings, exposure and curve. The scene has its baked light if the integrator shows that.

    Raises
    ------
    OSError
        If the file, or one that it names, cannot be opened.
    ValueError
        If anything in it is wrong; the message begins with file, line and key.

    Notes
    -----
    Keys are the names of Python parameters, and "none" stands for None. docs/scenes.md has all tables::

        background = [0.5, 0.6, 0.8]           # or "none", "environment"; exposure and curve as for `write_image`

        [models.bust]                          # the parameters of `Model`, and either
        procedural = "statue"                  # with points (and seed), or file = "scan.ply"
        points = 100_000

        [materials.gold]                       # a class of material, and its parameters
        kind = "principled"
        base_color = [1.0, 0.77, 0.34]
        metallic = 1.0

        [[instances]]                          # transform, or the parameters of `transform`
        model = "bust"                         # transforms = "many.npy": (n, 4, 4)
        material = "gold"
        rotate = 30

        [[planes]]                             # `Plane`
        point = [0, 0, 0]
        normal = [0, 0, 1]

        [[lights]]                             # kinds: point, sun, rect, disk, sphere, environment
        kind = "sun"
        direction = [1, 1, -1.5]

        [[clips]]                              # `Scene.clips`: the side that the normal points to is cut away
        point = [0, 0, 1.5]
        normal = [0, 0, 1]

        [camera]                               # `Camera.look_at`; without eye and target `Camera.frame`
        size = [320, 400]

        [settings]                             # `Settings`
        spp = 16

        [bake]                                 # `BakeSettings`, for the integrator "baked"
        file = "bust.bake"                     # its light, if the file is there: `pointray bake` writes it

    Examples
    --------
    >>> scene, camera, settings, exposure, curve = pr.load_scene("bust.toml")
    >>> pr.write_image("bust.png", pr.render(scene, camera, settings), exposure, curve)
    """
    check_path(path)
    check_callback(progress)
    return Plan(path).build(progress)
