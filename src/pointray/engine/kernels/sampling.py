"""Stratified random numbers in 0..1, which depend only on pixel, sample, dimension and seed.

Each pair of dimensions is the first two of Sobol's sequence, with order and digits scrambled by its own hash (Owen
scrambling by hashing: Burley 2020; permutation after Laine and Karras 2011). So every pair is stratified by itself for
any number of samples, best for powers of two, and the image does not depend on the number of threads.
"""

from __future__ import annotations

import math

from ..jit import Array, inline

# The pairs of dimensions in use; those of a path repeat for each scattering.
IN_PIXEL, ON_LENS, ON_PATH = 0, 1, 2
WHICH, ON_LIGHT, DIRECTION_OF, ROULETTE, PER_SCATTERING = range(5)  # the first: choice of the light or the lobe

_WORD = 0xFFFFFFFF
_TO_ONE = 2.0**-32


@inline
def hash32(x: int) -> int:
    """Hash a 32-bit word (the finaliser of MurmurHash3)."""
    x = ((x ^ (x >> 16)) * 0x85EBCA6B) & _WORD
    x = ((x ^ (x >> 13)) * 0xC2B2AE35) & _WORD
    return x ^ (x >> 16)


@inline
def pixel_key(x: int, y: int, seed: int) -> int:
    """Return the 32-bit key from which all random numbers of a pixel are computed. x, y : its column and row"""
    return hash32((hash32((hash32(x + 0x9E3779B9 & _WORD) + y) & _WORD) + seed) & _WORD)


@inline
def _reverse(x: int) -> int:
    """Reverse the order of 32 bits."""
    x = (x >> 16 | x << 16) & _WORD
    x = (x & 0x00FF00FF) << 8 | (x & 0xFF00FF00) >> 8
    x = (x & 0x0F0F0F0F) << 4 | (x & 0xF0F0F0F0) >> 4
    x = (x & 0x33333333) << 2 | (x & 0xCCCCCCCC) >> 2
    return (x & 0x55555555) << 1 | (x & 0xAAAAAAAA) >> 1


@inline
def _permute(x: int, key: int) -> int:
    """Permute 32-bit words, to scramble a Sobol sequence: each bit is flipped by a hash of the bits below it.

    This is Owen scrambling for words whose bits are reversed. key : selects the permutation
    """
    x = (x + key) & _WORD
    x ^= (x * 0x6C50B47C) & _WORD
    x ^= (x * 0xB82F1E52) & _WORD
    x ^= (x * 0xC7AFE638) & _WORD
    return x ^ ((x * 0x8D22F6E6) & _WORD)


@inline
def _second(x: int) -> int:
    """Return the second coordinate of a point of Sobol's sequence as a bit-reversed 32-bit fraction.

    x : bit-reversed index of the point; the generator matrix is Pascal's triangle modulo 2
    """
    x ^= (x & 0xFFFF0000) >> 16
    x ^= (x & 0xFF00FF00) >> 8
    x ^= (x & 0xF0F0F0F0) >> 4
    x ^= (x & 0xCCCCCCCC) >> 2
    return x ^ (x & 0xAAAAAAAA) >> 1


@inline
def sample_pair(key: int, sample: int, pair: int) -> tuple[float, float]:
    """Return two stratified random numbers, 0 <= u, v < 1, for one decision of a sample, such as a point on a light.

    key : key of the pixel, from `pixel_key`; sample : index of the sample in the pixel
    pair : number of the decision in the sample
    """
    key = hash32((key + pair * 0x9E3779B9) & _WORD)
    index = _reverse(_permute(_reverse(sample), key))
    u = _reverse(_permute(index, hash32(key ^ 0x2C1B3C6D)))
    v = _reverse(_permute(_second(index), hash32(key ^ 0x297A2D39)))
    return u * _TO_ONE, v * _TO_ONE


@inline
def on_disc(u: float, v: float) -> tuple[float, float]:
    """Map the unit square to the unit disc, preserving areas (concentric map, Shirley and Chiu 1997)."""
    a, b = 2.0 * u - 1.0, 2.0 * v - 1.0
    if abs(a) > abs(b):
        radius, angle = a, 0.25 * math.pi * b / a
    else:
        radius, angle = b, math.pi * (0.5 - 0.25 * a / b) if b != 0.0 else 0.0
    return radius * math.cos(angle), radius * math.sin(angle)


@inline
def find_share(table: Array, first: int, count: int, share: float) -> int:
    """Return the last k < count with table[first + k] <= share, by bisection: samples a cumulative distribution.

    table : table[first : first + count + 1] ascends from 0 to 1
    share : random number
    """
    low, high = 0, count
    while high - low > 1:
        middle = (low + high) // 2
        if table[first + middle] <= share:
            low = middle
        else:
            high = middle
    return low
