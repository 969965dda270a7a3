"""The loop that passes rays to Embree, one by one or 16 at a time."""

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from pointray.engine import jit

TILE = 1024  # rays that a thread takes at a time

# A ray and its hit are 20 words (RTCRay, then RTCHit), each of them 1 or 16 lanes wide.
ORIGIN, TNEAR, DIRECTION, TIME, TFAR, MASK, ID, FLAGS, GEOMETRY, WORDS = 0, 3, 4, 7, 8, 9, 10, 11, 18, 20
CONTEXT = WORDS * 16  # then RTCIntersectContext: flags, gap, filter (2 words), instID
VALID = CONTEXT + 16  # then flags of the 16 lanes of a packet that are in use
SCRATCH = VALID + 16
INVALID = np.uint32(0xFFFFFFFF)


@intrinsic
def _call(typingctx, address, arguments):  # type: ignore[no-untyped-def]
    """Call the C function at an address with pointers; a pointer is an int64."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        pointer = ir.IntType(8).as_pointer()
        prototype = ir.FunctionType(ir.VoidType(), [pointer] * len(arguments))
        function = builder.inttoptr(args[0], prototype.as_pointer())
        numbers = [builder.extract_value(args[1], i) for i in range(len(arguments))]
        builder.call(function, [builder.inttoptr(number, pointer) for number in numbers])
        return context.get_dummy_value()

    return types.void(types.int64, arguments), codegen


@jit.inline
def _scratch(width, flags):  # type: ignore[no-untyped-def]
    """A thread's ray, context and valid lanes, aligned to 64 bytes, with everything that all rays share filled in."""
    block = np.zeros(SCRATCH + 16, np.uint32)
    skip = (-block.ctypes.data % 64) // 4
    scratch = block[skip : skip + SCRATCH]
    scratch[MASK * width : (MASK + 1) * width] = INVALID
    scratch[CONTEXT] = flags
    scratch[CONTEXT + 4] = INVALID
    return scratch


@jit.inline
def _fill(floats, words, width, lane, origin, direction):  # type: ignore[no-untyped-def]
    """Write one ray into its lane."""
    for axis in range(3):
        floats[(ORIGIN + axis) * width + lane] = origin[axis]
        floats[(DIRECTION + axis) * width + lane] = direction[axis]
    floats[TFAR * width + lane] = np.inf
    words[GEOMETRY * width + lane] = INVALID


@jit.kernel
def trace_singles(work, function, scene, flags, origins, directions, t):  # type: ignore[no-untyped-def]
    """Trace ray by ray and keep `tfar`."""
    words = _scratch(1, flags)
    floats = words.view(np.float32)
    ray = words.ctypes.data
    while True:
        tile = jit.next_tile(work)
        if tile < 0:
            return
        for i in range(tile * TILE, min(tile * TILE + TILE, len(t))):
            _fill(floats, words, 1, 0, origins[i], directions[i])
            _call(function, (scene, ray + 4 * CONTEXT, ray))
            t[i] = floats[TFAR]


@jit.kernel
def trace_packets(work, function, scene, flags, origins, directions, t):  # type: ignore[no-untyped-def]
    """Trace 16 rays at a time and keep `tfar`."""
    words = _scratch(16, flags)
    floats = words.view(np.float32)
    ray = words.ctypes.data
    words[VALID : VALID + 16] = INVALID
    while True:
        tile = jit.next_tile(work)
        if tile < 0:
            return
        for first in range(tile * TILE, min(tile * TILE + TILE, len(t)), 16):
            count = min(16, len(t) - first)
            for lane in range(count):
                _fill(floats, words, 16, lane, origins[first + lane], directions[first + lane])
            if count < 16:
                words[VALID + count : VALID + 16] = 0
            _call(function, (ray + 4 * VALID, scene, ray + 4 * CONTEXT, ray))
            t[first : first + count] = floats[TFAR * 16 : TFAR * 16 + count]
