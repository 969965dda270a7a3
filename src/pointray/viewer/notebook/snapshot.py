"""Pictures of a view for Python and for saved notebooks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from PIL import Image

from ...auto_view.studio import with_direct_light
from ...baking.baked import Baked, bake
from ...baking.settings import BakeSettings
from ...image.screen import to_8bit
from ...image.tone import backdrop_rows
from ...rendering.picture import check_picture, picture_bytes, render
from ...scene.scene import Scene
from ..contacts import Contacts
from ..painter import BAKED, FrameRequest

LightOf = Callable[[Scene], Baked | None]


def draw(request: FrameRequest, samples: int, light_of: LightOf, bakes: bool = True) -> Image.Image:
    """Render a request as the page shows it.

    Parameters
    ----------
    request : FrameRequest
        The size of its camera is that of the picture.
    samples : int
        Samples per pixel.
    light_of : callable
        Returns the baked light of a scene, or None.
    bakes : bool
        Whether missing light is baked, which takes seconds to minutes; otherwise direct light is used.
    """
    settings, camera = request.view.settings(samples), request.camera
    check_picture(camera.size, picture_bytes(settings))
    scene = request.view.apply(request.scene, request.up)
    if settings.integrator == BAKED:
        own = request.scene.baked  # such as from a file
        scene.baked = own if isinstance(own, Baked) and own.fits(scene) else light_of(scene)
        if scene.baked is None and bakes:
            scene.baked = bake(scene.copy(), BakeSettings())
        if scene.baked is None:
            settings = replace(with_direct_light(settings), sky_rays=0)
    image = render(scene, camera, settings)
    tone = request.view.tone(image)
    shadow = Contacts().of(request.scan, (scene, request.version), request.view)
    image = image if shadow is None else shadow.put_under(image, camera)
    behind = backdrop_rows(request.view.behind, len(image))[:, 0]
    return Image.fromarray(to_8bit(image, behind, *tone))
