"""Scene files: whole scenes as TOML, whose keys are the names of Python classes and parameters.

source, lines : the text, and the line of each key
words : the keys of a table, from the signatures of Python classes and functions
shading, models, instances, light : the parts of a scene, first checked, then built
plan : the whole file

Begin with plan.
"""

from __future__ import annotations

import os

from ..base.arguments import check_callback, check_path
from ..base.manual import noted
from ..base.progress import StageProgress
from .plan import Plan, SceneFile

__all__ = ["Plan", "SceneFile", "load_scene"]


def load_scene(path: str | os.PathLike[str], progress: StageProgress | None = None) -> SceneFile:
    """Build the scene of a TOML file.

    The file is checked completely before any file that it refers to is read.

    Parameters
    ----------
    path : str or path
        Paths within the file are relative to its folder.
    progress : callable, optional
        Called as `progress(stage, share)` with the name of the stage and its completed share, 0 to 1.

    Returns
    -------
    SceneFile
        `scene`, `camera`, `settings`, `exposure` and `curve`. The scene has baked light if the integrator is "baked".

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    OSError
        If the file, or one that it refers to, cannot be opened.
    ImportError
        If a package is missing that a file needs.
    ValueError
        If the file is invalid. The message begins with file, line and key.

    Notes
    -----
    Keys are the names of Python parameters; "none" stands for None. https://pointray.readthedocs.io/page/scenes.html
    describes all tables::

        background = [0.5, 0.6, 0.8]           # or "none", "environment"; exposure and curve as for `write_image`

        [models.bust]                          # parameters of `Model`, and either file = "scan.ply"
        procedural = "statue"                  # or procedural with points (and seed)
        points = 100_000

        [materials.gold]                       # a class of materials, and its parameters
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

        [[clips]]                              # `Scene.clips`: cuts away the side that the normal points to
        point = [0, 0, 1.5]
        normal = [0, 0, 1]

        [camera]                               # `Camera.look_at`; without eye and target `Camera.frame`
        size = [320, 400]

        [settings]                             # `Settings`
        spp = 16

        [bake]                                 # `BakeSettings`, for the integrator "baked"
        file = "bust.bake"                     # light written by `pointray bake`; baked if the file is missing

    Examples
    --------
    >>> with open("ball.toml", "w") as file:
    ...     print('models.ball = {procedural = "sphere", points = 1000}', file=file)
    ...     print('instances = [{model = "ball"}]', file=file)
    ...     print('camera = {size = [32, 24]}', file=file)
    >>> scene, camera, settings, exposure, curve = pr.load_scene("ball.toml")
    >>> pr.write_image("ball.png", pr.render(scene, camera, settings), exposure, curve)
    """
    check_path(path)
    check_callback(progress)
    with noted():
        return Plan(path).build(progress)
