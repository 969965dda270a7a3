"""Flat splats (the paper's figure 1a): each point a disc of its radius, at right angles to its normal. The baseline.

Start rule: discs of one sheet overlap and cut each other, so a shadow ray that starts on one would be blocked by the
others around it. A ray from a surface that starts NEAR radii or less from a disc's middle, and within FLAT radii of its
plane, starts on the sheet that this disc is of: the disc does not block it, unless the ray goes steeply to the side
that it does not start on, see `Frame.side`. A disc of another sheet is farther from its origin, or is met steeply.
Rays of a camera or a caller start on none: which part of them is looked at changes nothing in what they hit.
"""

from __future__ import annotations

from ..jit import f32, i64, inline
from ..kernels.records import BLOCK, INV_R2, NX, NY, NZ, PX, PY, PZ, Hit, Ray, Tree
from ..kernels.scratch import COUNT_NEAR, Scratch
from ..kernels.vec import Vec3
from ..simd import INF, ONE, ZERO, bits, count_trailing_zeros, lane, repeat4

NEAR2 = f32(2.0**2)  # squared radii: beside a disc's rim a ray would meet its underside
FLAT2 = f32(0.25**2)  # squared radii: two discs on a sphere of R are r / R apart, half of which is each one's
STEEP = f32(-0.35)  # cosine: as much may neighbours' normals differ where a ray leaves almost along the sheet


@inline
def search_discs(
    tree: Tree, leaf: int, scratch: Scratch, frame: tuple[Vec3, float, Ray], enter: float, leave: float
) -> Hit:
    """The nearest disc of the near blocks that the ray meets inside of the voxel: four discs at once.

    frame : where the first sample is, t there, and the ray
    """
    place, start, ray = frame
    on_surface, ahead = ray.t_min >= ZERO, ray.t_min - start
    ox, oy, oz = ahead * ray.dx, ahead * ray.dy, ahead * ray.dz
    nearest = INF
    nx = ny = nz = f32(0.0)
    for k in range(scratch.counts[COUNT_NEAR]):
        slot = i64(scratch.near[k]) * BLOCK
        qx, qy, qz = (
            repeat4(tree.blocks, slot + PX) - place[0],
            repeat4(tree.blocks, slot + PY) - place[1],
            repeat4(tree.blocks, slot + PZ) - place[2],
        )
        mx, my, mz = repeat4(tree.blocks, slot + NX), repeat4(tree.blocks, slot + NY), repeat4(tree.blocks, slot + NZ)
        slope = mx * ray.dx + my * ray.dy + mz * ray.dz
        s = (qx * mx + qy * my + qz * mz) / slope
        vx, vy, vz = s * ray.dx - qx, s * ray.dy - qy, s * ray.dz - qz
        inv_r2 = repeat4(tree.blocks, slot + INV_R2)
        inside = (vx * vx + vy * vy + vz * vz) * inv_r2 <= ONE
        t = s + start
        left = bits(inside & (t >= enter) & (t <= leave) & (t < nearest)) & 15
        if left != 0 and on_surface:
            wx, wy, wz = ox - qx, oy - qy, oz - qz
            height = wx * mx + wy * my + wz * mz
            around = ((wx * wx + wy * wy + wz * wz) * inv_r2 <= NEAR2) & (height * height * inv_r2 <= FLAT2)
            left &= ~bits(around & (slope * ray.side > STEEP))
        while left != 0:
            j = count_trailing_zeros(left)
            left &= left - 1
            if lane(t, j) < nearest:
                nearest = lane(t, j)
                nx, ny, nz = lane(mx, j), lane(my, j), lane(mz, j)
    return Hit(nearest, nx, ny, nz, leaf if nearest < INF else -1)
