"""The result of `render`: an image, or all its layers."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from .cluster import wait_for_kernels
from .waiting import Progress, in_background, writing

LEGEND_BYTES = 8  # per pixel, for the copy of the image into which the legend is drawn


def is_layered(output: Path) -> bool:
    """Return whether a result has the extension .exr or .npz: it then holds all layers of an image (depth, ...)."""
    from ..image.write import LAYERED

    return output.suffix.lower() in LAYERED


def check_output(output: Path, exposed: bool, legend: bool) -> None:
    """Raise an error, before any work is done, if the result of `render` cannot be written to its path.

    exposed, legend : whether --exposure or --legend was given, which layers (.exr, .npz) do not support
    """
    from ..base.atomic_write import check_writable, unsupported_extension
    from ..image.write import LAYERED, SHOWN, check_layers_path

    if is_layered(output):
        check_layers_path(output)
        for option, given in (("--exposure", exposed), ("--legend", legend)):
            if given:
                raise ValueError(f"{output}: layers store linear light; {option} requires {', '.join(SHOWN)}")
        return
    if output.suffix.lower() not in SHOWN:
        raise unsupported_extension(output, (*SHOWN, *LAYERED))
    check_writable(output)


def check_fits(output: Path, size: tuple[int, int], settings: Any, legend: bool = False) -> None:
    """Raise ValueError if there is not enough memory for rendering and writing an image.

    output : its path, with the extension of an image or of layers; size : width and height
    settings : `Settings` of rendering; legend : whether a legend of colours is drawn, which needs more memory
    """
    from ..image.write import EXR_BYTES, LAYERED, SHOWN_BYTES
    from ..rendering.layers import LAYER_BYTES
    from ..rendering.picture import check_picture, picture_bytes

    if is_layered(output):
        more = EXR_BYTES if LAYERED[output.suffix.lower()] == "EXR" else 0
        check_picture(size, max(picture_bytes(settings), LAYER_BYTES + more))
        return
    check_picture(size, picture_bytes(settings, written=SHOWN_BYTES + (LEGEND_BYTES if legend else 0)))


class Shown(NamedTuple):
    """How a rendered image is converted to the pixels of a file.

    Attributes
    ----------
    exposure : float or "auto"
        In stops.
    curve : str
        Name of the tone curve, or "auto".
    legend : Attribute or None
        Attribute of the points that colours the image; its legend is drawn.
    backdrop : two sRGB colours, or None
        Colours at the top and bottom of the background.
    shadow : ContactShadow or None
        Shadow of a standing object, drawn under the image on an invisible ground.
    """

    exposure: float | str = 0.0
    curve: str = "srgb"
    legend: Any = None
    backdrop: Any = None
    shadow: Any = None


def write_picture(output: Path, job: tuple[Any, Any, Any], shown: Shown, progress: Progress, client: Any = None) -> str:
    """Render an image, or its layers (.exr, .npz), and write it.

    Return a text for the end of the command's message about the file, such as ", exposure 1.5" or "".

    job : scene, camera and settings; shown : how to convert the image to pixels
    client : Dask client whose workers render; None: this process
    """
    import pointray as pr

    from ..image.exposure import tone_of, white_under
    from ..rendering.layers import render_layers
    from ..rendering.picture import render

    wait_for_kernels(client, job[2])
    if not is_layered(output):
        image = in_background(lambda: render(*job, progress.show, client))
        with writing(output):
            white = white_under(job[0].lights, job[2].integrator)
            exposure, curve = tone_of(image, shown.exposure, shown.curve, white)
            if shown.shadow is not None:
                image = shown.shadow.put_under(image, job[1])
            pr.write_image(output, image, exposure, curve, shown.legend, shown.backdrop)
        soft = ", highlights softened" if shown.curve != curve == "soft" else ""
        return f", exposure {exposure:g}{soft}" if shown.exposure == "auto" else ""
    layers = in_background(lambda: render_layers(*job, progress.show, client))
    with writing(output):
        pr.write_layers(output, layers)
    return f", {len(layers)} layers"
