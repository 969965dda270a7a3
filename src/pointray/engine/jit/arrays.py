"""Array functions of kernels: arrays from an address, arrays without reference counts, atomic access."""

from __future__ import annotations

from .decorators import later

LATER = ("intrinsics",)
array_at, borrow, fetch_add, keep_alive, peek = later(
    __package__, LATER, "array_at", "borrow", "fetch_add", "keep_alive", "peek"
)
