"""Pictures of the sky: Radiance .hdr in all its forms, and .exr, .png and .jpg if a library can write them.

A picture that is accepted lights a sphere, and every pixel of the result must be a number.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

import pointray as pr
from attack import Attack, WrongError
from attack.mutate import WORDS, Rng, corrupt, pick

SHAPE = (8, 16)
NUMBERS = (0, 1, -1, 2**31 - 1, -(2**31), 7, 8, 9, 16384, 16385, 65536, 10**6, 0x7F800000, 0x7FC00000, -8388608)


def rgbe(rng: Rng, shape: tuple[int, int] = SHAPE) -> NDArray[np.uint8]:
    """Pixels of a Radiance file: three mantissas and an exponent."""
    pixels = rng.integers(0, 256, (*shape, 4), np.uint8)
    pixels[..., 3] = rng.integers(120, 134, shape)
    return pixels


def hdr(rng: Rng) -> bytes:
    """A Radiance file, flat or with run-length encoded rows."""
    pixels = rgbe(rng)
    height, width = pixels.shape[:2]
    head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=1.0\n\n" + f"-Y {height} +X {width}\n".encode()
    if rng.random() < 0.4:
        return head + pixels.tobytes()
    body = b""
    for row in pixels:
        body += bytes([2, 2, width >> 8, width & 255])
        for channel in row.T:
            if rng.random() < 0.3:
                body += bytes([128 + width, int(channel[0])])
            else:
                body += bytes([width]) + channel.tobytes()
    return head + body


def others(folder: Path) -> list[tuple[str, bytes]]:
    """Files of the formats that an installed library can write: (extension, contents)."""
    rng, out = np.random.default_rng(3), []
    image = rng.random((*SHAPE, 3)).astype(np.float32)
    shown = (image * 255).astype(np.uint8)
    for extension in (".png", ".jpg"):
        Image.fromarray(shown).save(folder / f"a{extension}")
        out.append((extension, (folder / f"a{extension}").read_bytes()))
    try:
        import OpenImageIO as oiio  # noqa: N813
    except ImportError:
        return out
    path = folder / "a.exr"
    for compression in ("none", "rle", "zip", "piz", "pxr24", "b44", "dwaa"):
        for kind in ("half", "float"):
            spec = oiio.ImageSpec(SHAPE[1], SHAPE[0], 3, kind)
            spec.attribute("compression", compression)
            file = oiio.ImageOutput.create(str(path))
            file.open(str(path), spec)
            file.write_image(image)
            file.close()
            out.append((".exr", path.read_bytes()))
    return out


def lie_header(rng: Rng, data: bytes) -> bytes:
    """Change a text or an integer of the header."""
    end = (
        max(data.find(b"\n", data.find(b"\n\n") + 2), min(len(data), 350)) if data[:2] == b"#?" else min(len(data), 350)
    )
    if data[:2] == b"#?":
        words = data[:end].split(b" ")
        words[int(rng.integers(len(words)))] = pick(rng, (*WORDS, "-Y", "+X", "16385", "1000000", "\n")).encode()
        return b" ".join(words) + data[end:]
    at = int(rng.integers(4, max(end - 4, 5)))
    return data[:at] + struct.pack(pick(rng, ("<i", ">i")), pick(rng, NUMBERS)) + data[at + 4 :]


def lie_window(rng: Rng, data: bytes) -> bytes:
    """Change a number in the header of an .exr, such as its size."""
    at = data.find(
        pick(rng, (b"dataWindow\0box2i\0", b"displayWindow\0box2i\0", b"chlist\0", b"tiles\0", b"compression\0"))
    )
    if at < 0:
        return lie_header(rng, data)
    at = data.index(b"\0", data.index(b"\0", at) + 1) + 5
    at += 4 * int(rng.integers(4))
    return data[:at] + struct.pack("<i", pick(rng, NUMBERS)) + data[at + 4 :]


def damage(rng: Rng, data: bytes) -> bytes:
    """Damage any bytes, or those of the pixels only."""
    at = int(rng.random() < 0.7) * len(data) // 3
    return data[:at] + corrupt(rng, data[at:], 2)


def begin(folder: Path) -> Attack:
    """Mutated pictures of the sky."""
    made = others(folder)
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(60, 3))
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    model = pr.Model(pr.Points(rows, rows))
    camera = pr.Camera.look_at((0, -6, 1), (0, 0, 0), fov=70, size=(8, 8))

    def light(path: Path, integrator: str) -> None:
        scene = pr.Scene()
        scene.add(model)
        scene.add_light(pr.EnvironmentLight(image=path))
        scene.background = "environment"
        if not np.isfinite(pr.render(scene, camera, pr.Settings(integrator))).all():
            raise WrongError("a pixel is not finite")

    def attack(rng: Rng, index: int) -> bool:
        extension, data = (".hdr", hdr(rng)) if rng.random() < 0.4 else pick(rng, made)
        kind = rng.random()
        if kind > 0.03:
            data = damage(rng, data) if kind < 0.7 else lie_window(rng, data)
            data = corrupt(rng, data, 1) if kind > 0.9 else data
        if rng.random() < 0.03:
            extension = pick(rng, (".hdr", ".exr", ".png", ".jpg", ".tif", ".toml"))
        path = folder / f"sky{extension}"
        path.write_bytes(data)
        try:
            light(path, pick(rng, ("phong", "path")))
        except (ValueError, OSError) as error:
            if kind <= 0.03 and extension == ".hdr":
                raise WrongError(f"a valid file is refused: {error}") from error
            return False
        finally:
            path.unlink()
        return True

    (folder / "sky.hdr").write_bytes(hdr(rng))
    for integrator in ("phong", "path"):
        light(folder / "sky.hdr", integrator)
    return attack
