"""Numbered pictures -> MP4, by the ffmpeg that imageio-ffmpeg brings."""

from __future__ import annotations

import errno
import struct
import subprocess
from pathlib import Path

from ..base.atomic_write import check_writable, replacing
from ..base.extras import require

CRF = "18"  # x264's quality: no difference to the pictures is seen


def check_mp4(path: Path) -> None:
    """Raise what would keep an MP4 from being written, before the work is done."""
    require("imageio_ffmpeg", "film", str(path)).get_ffmpeg_exe()
    check_writable(path)


def even(size: tuple[int, int]) -> tuple[int, int]:
    """The size of a film of pictures: its colours are stored for 2 x 2 pixels."""
    return size[0] + size[0] % 2, size[1] + size[1] % 2


def write_mp4(path: Path, pattern: Path, count: int, fps: float, size: tuple[int, int]) -> None:
    """Write the first `count` numbered pictures of a size as H.264, yuv420p, for any player.

    Odd sides get one more row or column, like the last one. OSError says what ffmpeg could not do.
    """
    width, height = even(size)
    filters = [
        f"pad={width}:{height}",
        f"fillborders=right={width - size[0]}:bottom={height - size[1]}:mode=smear",
        "scale=out_color_matrix=bt709:out_range=tv",
        "format=yuv420p",
        # Where it is not said, players guess the matrix of the colours by the film's size.
        "setparams=colorspace=bt709:color_primaries=bt709:color_trc=bt709",
    ]
    command = [require("imageio_ffmpeg", "film", str(path)).get_ffmpeg_exe(), "-nostdin", "-loglevel", "error", "-y"]
    command += ["-framerate", f"{fps:.12g}", "-start_number", "0", "-i", pattern.name, "-frames:v", str(count)]
    command += ["-vf", ",".join(filters), "-c:v", "libx264", "-crf", CRF, "-movflags", "+faststart"]
    with replacing(path) as beside:
        # In the pictures' folder: ffmpeg would take a % in its name for a number.
        done = subprocess.run([*command, str(beside.path)], cwd=pattern.parent, capture_output=True, text=True)
        if done.returncode != 0:
            last = (done.stderr.strip().splitlines() or [f"status {done.returncode}"])[-1]
            raise OSError(errno.EIO, f"ffmpeg: {last}", str(path))
        _check_whole(beside.path)


def _check_whole(path: Path) -> None:
    """OSError if a film was cut off: its boxes do not end where the file does, or one of the three is missing."""
    end, offset, kinds = path.stat().st_size, 0, set()
    with path.open("rb") as file:
        while offset < end:
            file.seek(offset)
            size, kind = struct.unpack(">I4s", file.read(8).ljust(8, b"\0"))
            if size == 1:  # more than 4 GiB: the size comes behind
                size = int.from_bytes(file.read(8), "big")
            if size < 8:
                break
            kinds.add(kind)
            offset += size
    if offset != end or not {b"ftyp", b"moov", b"mdat"} <= kinds:
        raise OSError(errno.EIO, "the film was cut off: is the disk full?", str(path))
