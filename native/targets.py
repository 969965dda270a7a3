"""Processors and systems that libraries are built for."""

from __future__ import annotations

from dataclasses import dataclass

_V2 = "+64bit,+cmov,+cx16,+cx8,+fxsr,+mmx,+popcnt,+sahf,+sse,+sse2,+sse3,+sse4.1,+sse4.2,+ssse3"
_V3 = f"{_V2},+avx,+avx2,+bmi,+bmi2,+f16c,+fma,+lzcnt,+movbe,+xsave"
_V4 = f"{_V3},+avx512bw,+avx512cd,+avx512dq,+avx512f,+avx512vl"


@dataclass(frozen=True)
class Level:
    """A processor level. name : in Numba and LLVM; features : in LLVM's format"""

    name: str
    features: str


LEVELS = {
    "x86-64-v2": Level("x86-64-v2", _V2),
    "x86-64-v3": Level("x86-64-v3", _V3),
    "x86-64-v4": Level("x86-64-v4", _V4),
    "aarch64": Level("generic", "+fp-armv8,+neon"),
}


@dataclass(frozen=True)
class System:
    """An operating system.

    triple : its name in LLVM; zig : in Zig; wheel : the platform tag of wheels; ending : of shared libraries
    levels : the processor levels that libraries are built for
    """

    triple: str
    zig: str
    wheel: str
    ending: str
    levels: tuple[str, ...]


_X86 = "x86-64-v2", "x86-64-v3", "x86-64-v4"
_ARM = ("aarch64",)
SYSTEMS = {
    "linux-x86_64": System("x86_64-unknown-linux-gnu", "x86_64-linux-gnu.2.17", "manylinux_2_17_x86_64", ".so", _X86),
    "linux-aarch64": System(
        "aarch64-unknown-linux-gnu", "aarch64-linux-gnu.2.17", "manylinux_2_17_aarch64", ".so", _ARM
    ),
    "windows-x86_64": System("x86_64-pc-windows-gnu", "x86_64-windows-gnu", "win_amd64", ".dll", _X86),
    "macos-arm64": System("arm64-apple-macosx11.0.0", "aarch64-macos.11.0", "macosx_11_0_arm64", ".dylib", _ARM),
    "macos-x86_64": System("x86_64-apple-macosx10.15.0", "x86_64-macos.10.15", "macosx_10_15_x86_64", ".dylib", _X86),
}
