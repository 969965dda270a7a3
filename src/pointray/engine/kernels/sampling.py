"""Where samples lie: numbers in 0..1 that depend on pixel, sample, dimension and seed, and on nothing else.

Pairs of dimensions are each the first two of Sobol's sequence, in an order and with digits shuffled by a hash of their
own (Owen scrambling by hashing: Burley 2020; permutation after Laine and Karras 2011). So every pair is stratified by
itself at any number of samples, best at powers of two, and the picture is the same for any number of threads.
"""

from __future__ import annotations

import math

from ..jit import Array, inline

# The pairs of dimensions that are asked for; those of a path repeat for each scattering.
IN_PIXEL, ON_LENS, ON_PATH = 0, 1, 2
WHICH, ON_LIGHT, DIRECTION_OF, ROULETTE, PER_SCATTERING = range(5)  # the first: which light, which lobe

_WORD = 0xFFFFFFFF
_TO_ONE = 2.0**-32


@inline
def hash32(x: int) -> int:
    """A well mixed word of 32 bits from another (the finaliser of MurmurHash3)."""
    x = ((x ^ (x >> 16)) * 0x85EBCA6B) & _WORD
    x = ((x ^ (x >> 13)) * 0xC2B2AE35) & _WORD
    return x ^ (x >> 16)


@inline
def pixel_key(x: int, y: int, seed: int) -> int:
    """The key of a pixel's samples."""
    return hash32((hash32((hash32(x + 0x9E3779B9 & _WORD) + y) & _WORD) + seed) & _WORD)


@inline
def _reverse(x: int) -> int:
    """The 32 bits in the opposite order."""
    x = (x >> 16 | x << 16) & _WORD
    x = (x & 0x00FF00FF) << 8 | (x & 0xFF00FF00) >> 8
    x = (x & 0x0F0F0F0F) << 4 | (x & 0xF0F0F0F0) >> 4
    x = (x & 0x33333333) << 2 | (x & 0xCCCCCCCC) >> 2
    return (x & 0x55555555) << 1 | (x & 0xAAAAAAAA) >> 1


@inline
def _permute(x: int, key: int) -> int:
    """Each bit is flipped or not by a hash of the bits below it: Owen scrambling of a word with its bits reversed."""
    x = (x + key) & _WORD
    x ^= (x * 0x6C50B47C) & _WORD
    x ^= (x * 0xB82F1E52) & _WORD
    x ^= (x * 0xC7AFE638) & _WORD
    return x ^ ((x * 0x8D22F6E6) & _WORD)


@inline
def _second(x: int) -> int:
    """Sobol's second dimension from the number of the sample, bits reversed: Pascal's triangle modulo 2."""
    x ^= (x & 0xFFFF0000) >> 16
    x ^= (x & 0xFF00FF00) >> 8
    x ^= (x & 0xF0F0F0F0) >> 4
    x ^= (x & 0xCCCCCCCC) >> 2
    return x ^ (x & 0xAAAAAAAA) >> 1


@inline
def sample_pair(key: int, sample: int, pair: int) -> tuple[float, float]:
    """Two numbers, 0 <= u, v < 1, for a sample of a pixel and a pair of dimensions."""
    key = hash32((key + pair * 0x9E3779B9) & _WORD)
    index = _reverse(_permute(_reverse(sample), key))
    u = _reverse(_permute(index, hash32(key ^ 0x2C1B3C6D)))
    v = _reverse(_permute(_second(index), hash32(key ^ 0x297A2D39)))
    return u * _TO_ONE, v * _TO_ONE


@inline
def on_disc(u: float, v: float) -> tuple[float, float]:
    """The point of the unit disc for a point of the square: equal areas, rings to rings (Shirley and Chiu 1997)."""
    a, b = 2.0 * u - 1.0, 2.0 * v - 1.0
    if abs(a) > abs(b):
        radius, angle = a, 0.25 * math.pi * b / a
    else:
        radius, angle = b, math.pi * (0.5 - 0.25 * a / b) if b != 0.0 else 0.0
    return radius * math.cos(angle), radius * math.sin(angle)


@inline
def find_share(table: Array, first: int, count: int, share: float) -> int:
    """The last k of a rising part of a table, of count + 1 numbers from first on, at which it is not above share."""
    low, high = 0, count
    while high - low > 1:
        middle = (low + high) // 2
        if table[first + middle] <= share:
            low = middle
        else:
            high = middle
    return low
