"""Encoding of numbered images as MP4, with the ffmpeg of imageio-ffmpeg."""

from __future__ import annotations

import errno
import struct
import subprocess
from pathlib import Path

from ..base.atomic_write import check_writable, replacing
from ..base.extras import require

CRF = "18"  # x264 quality: visually lossless


def check_mp4(path: Path) -> None:
    """Raise an error if an MP4 cannot be written to a path, before its frames are rendered.

    Raises
    ------
    ImportError
        If imageio-ffmpeg is not installed.
    OSError
        If the file or its folder is not writable.
    """
    require("imageio_ffmpeg", "film", str(path)).get_ffmpeg_exe()
    check_writable(path)


def even(size: tuple[int, int]) -> tuple[int, int]:
    """Return the (width, height) of a video, rounded up to even numbers, as chroma is stored for 2 x 2 pixels."""
    return size[0] + size[0] % 2, size[1] + size[1] % 2


def write_mp4(path: Path, pattern: Path, count: int, fps: float, size: tuple[int, int]) -> None:
    """Encode the first `count` numbered images as an MP4 video: H.264, yuv420p.

    Odd sides are extended by a copy of the last row or column. OSError contains the error of ffmpeg.

    pattern : path of the images, with `%d` or `%04d` for the number; fps : frames per second; size : width, height
    """
    width, height = even(size)
    filters = [
        f"pad={width}:{height}",
        f"fillborders=right={width - size[0]}:bottom={height - size[1]}:mode=smear",
        "scale=out_color_matrix=bt709:out_range=tv",
        "format=yuv420p",
        # Without these, players guess the colour matrix from the size.
        "setparams=colorspace=bt709:color_primaries=bt709:color_trc=bt709",
    ]
    command = [require("imageio_ffmpeg", "film", str(path)).get_ffmpeg_exe(), "-nostdin", "-loglevel", "error", "-y"]
    command += ["-framerate", f"{fps:.12g}", "-start_number", "0", "-i", pattern.name, "-frames:v", str(count)]
    command += ["-vf", ",".join(filters), "-c:v", "libx264", "-crf", CRF, "-movflags", "+faststart"]
    with replacing(path) as beside:
        # Run in the images' folder, as ffmpeg would interpret a % in the folder's name.
        done = subprocess.run([*command, str(beside.path)], cwd=pattern.parent, capture_output=True, text=True)
        if done.returncode != 0:
            last = (done.stderr.strip().splitlines() or [f"status {done.returncode}"])[-1]
            raise OSError(errno.EIO, f"ffmpeg: {last}", str(path))
        _check_whole(beside.path)


def _check_whole(path: Path) -> None:
    """Raise OSError if an MP4 is truncated: boxes do not end with the file, or a required box is missing."""
    end, offset, kinds = path.stat().st_size, 0, set()
    with path.open("rb") as file:
        while offset < end:
            file.seek(offset)
            size, kind = struct.unpack(">I4s", file.read(8).ljust(8, b"\0"))
            if size == 1:  # more than 4 GiB: a 64-bit size follows
                size = int.from_bytes(file.read(8), "big")
            if size < 8:
                break
            kinds.add(kind)
            offset += size
    if offset != end or not {b"ftyp", b"moov", b"mdat"} <= kinds:
        raise OSError(errno.EIO, "the film is incomplete: is the disk full?", str(path))
