"""Flat splats (the paper's figure 1a), the baseline: each point is a disc of its radius, perpendicular to its normal.

Start rule: the discs of one sheet overlap and intersect, so a shadow ray that starts on one would be blocked by its
neighbours. A ray that starts on a surface within NEAR radii of a disc's centre and FLAT radii of its plane starts on
the sheet of that disc. The disc does not block it, unless the ray leaves steeply through the side opposite to
`Frame.side`. A disc of another sheet is farther from the origin, or is hit steeply. Rays of a camera or a caller start
on no sheet: their hits do not depend on the part that is searched.
"""

from __future__ import annotations

from ...engine.jit import f32, i64, inline
from ...engine.kernels.scratch import COUNT_NEAR, Scratch
from ...engine.kernels.tree import BLOCK, INV_R2, NX, NY, NZ, PX, PY, PZ, Hit, Ray, Tree
from ...engine.kernels.vec import Vec3
from ...engine.simd import INF, ONE, ZERO, bits, count_trailing_zeros, lane, repeat4

NEAR2 = f32(2.0**2)  # squared radii: close to a disc's rim a ray would hit its underside
FLAT2 = f32(0.25**2)  # squared radii: on a sphere of radius R two discs are r / R apart, half of it for each
STEEP = f32(-0.35)  # cosine: tolerance for the difference of neighbouring normals if a ray leaves along the sheet


@inline
def search_discs(
    tree: Tree, leaf: int, scratch: Scratch, frame: tuple[Vec3, float, Ray], enter: float, leave: float
) -> Hit:
    """Find the nearest disc that a ray hits inside a voxel, testing the discs of four points at once (surface "disc").

    Discs are those of the blocks listed in `scratch`, which are near the ray.

    frame : (position, t, ray), the ray, its first sample's t, and the position there
    enter, leave : t between which hits count
    """
    position, start, ray = frame
    on_surface, ahead = ray.t_min >= ZERO, ray.t_min - start
    ox, oy, oz = ahead * ray.dx, ahead * ray.dy, ahead * ray.dz
    nearest = INF
    nx = ny = nz = f32(0.0)
    for k in range(scratch.counts[COUNT_NEAR]):
        slot = i64(scratch.near[k]) * BLOCK
        qx, qy, qz = (
            repeat4(tree.blocks, slot + PX) - position[0],
            repeat4(tree.blocks, slot + PY) - position[1],
            repeat4(tree.blocks, slot + PZ) - position[2],
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
