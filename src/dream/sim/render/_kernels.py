"""The numba kernels of the rasteriser: visibility first, then one shading per pixel."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

Array = npt.NDArray[Any]
# A scalar of whichever width the kernel computes in; numba, not the annotation, fixes it.
Number = Any

# An image pixel names its triangle by entity << FACE_BITS | face of the entity's cluster.
FACE_BITS = 9
NOTHING = -1

# Pixels by which a triangle's bounding box is widened against rounding.
SLACK = 1e-6

# Tiles, as a power of two, that are added to a texture's coordinates so that they are positive.
BEFORE_BITS = 12
ANYWHERE = 2.0**30

# The values of `scene.Material`; a kernel's constants must be plain numbers.
SEABED, SHELL, ROCK, HULL, WOOD = 0, 1, 2, 3, 4

# Iron on a wooden wreck is redder than wood: its linear red is so many times its green.
RUSTY = 1.75

# Shares of the light that come from the whole sky of water and straight from the sun, on level ground.
AMBIENT, DIRECT = 0.42, 0.62

# Every operation is rounded by itself: fused or reordered, pixels would differ between processors.
_kernel = njit(cache=True, nogil=True, error_model="numpy")
_inlined = njit(cache=True, nogil=True, error_model="numpy", inline="always")


@_inlined
def _least(a: float, b: float, c: float) -> float:
    least = a if a < b else b
    return c if c < least else least


@_inlined
def _most(a: float, b: float, c: float) -> float:
    most = a if a > b else b
    return c if c > most else most


@_kernel
def _cells(count: int, xs: Array, ys: Array, out: Array) -> None:
    """Between which centres of pixels each vertex lies: the row in the high half, the column in the low.

    What lies off the image to the left or above counts as on its edge, where there is no centre yet.
    """
    half, zero, most = np.float32(0.5), np.float32(0.0), np.float32(32767.0)
    for k in range(count):
        column = np.int32(min(max(xs[k] + half, zero), most))
        row = np.int32(min(max(ys[k] + half, zero), most))
        out[k] = (row << np.int32(16)) | column


@_kernel
def _fill(
    inverse_depth: Array,
    triangle: Array,
    name: int,
    x0: float,
    y0: float,
    w0: float,
    x1: float,
    y1: float,
    w1: float,
    x2: float,
    y2: float,
    w2: float,
    area: float,
) -> None:
    """Write the triangle where it is nearest; (x, y) in pixels, w inverse depths, area signed and not 0."""
    height, width = inverse_depth.shape
    # A pixel belongs to the triangle that contains its centre, at a half-integer.
    # Cut off after adding whole pixels, which rounds down; one too many costs a test and changes nothing.
    left = int(max(_least(x0, x1, x2) + (0.5 - SLACK), 0.0))
    right = int(min(max(_most(x0, x1, x2) + (0.5 + SLACK), 0.0), width)) - 1
    top = int(max(_least(y0, y1, y2) + (0.5 - SLACK), 0.0))
    bottom = int(min(max(_most(y0, y1, y2) + (0.5 + SLACK), 0.0), height)) - 1
    if left > right or top > bottom:
        return
    scale = 1.0 / area
    # Barycentric weights of corners 1 and 2 are affine in the pixel: b = bx·x + by·y + bc.
    b1x, b1y = (y2 - y0) * scale, (x0 - x2) * scale
    b2x, b2y = (y0 - y1) * scale, (x1 - x0) * scale
    wx, wy = b1x * (w1 - w0) + b2x * (w2 - w0), b1y * (w1 - w0) + b2y * (w2 - w0)
    dx, dy = left + 0.5 - x0, top + 0.5 - y0
    b1_row, b2_row = b1x * dx + b1y * dy, b2x * dx + b2y * dy
    w_row = w0 + wx * dx + wy * dy
    for v in range(top, bottom + 1):
        b1, b2, w = b1_row, b2_row, w_row
        for u in range(left, right + 1):
            if b1 >= 0.0 and b2 >= 0.0 and b1 + b2 <= 1.0 and w > inverse_depth[v, u]:
                inverse_depth[v, u] = w
                triangle[v, u] = name
            b1 += b1x
            b2 += b2x
            w += wx
        b1_row += b1y
        b2_row += b2y
        w_row += wy


@_kernel
def _fill_clipped(
    inverse_depth: Array,
    triangle: Array,
    name: int,
    corners: Array,
    focal: Array,
    near: float,
    two_sided: bool,
) -> None:
    """Cut the triangle `corners` (3, 3), in camera axes, at depth `near` and fill what lies beyond."""
    polygon = np.empty((4, 3))
    count = 0
    for k in range(3):
        a, b = corners[k], corners[(k + 1) % 3]
        if a[2] >= near:
            polygon[count, 0] = focal[0] * a[0] / a[2] + focal[2]
            polygon[count, 1] = focal[1] * a[1] / a[2] + focal[3]
            polygon[count, 2] = 1.0 / a[2]
            count += 1
        if (a[2] >= near) != (b[2] >= near):
            t = (near - a[2]) / (b[2] - a[2])
            polygon[count, 0] = focal[0] * (a[0] + t * (b[0] - a[0])) / near + focal[2]
            polygon[count, 1] = focal[1] * (a[1] + t * (b[1] - a[1])) / near + focal[3]
            polygon[count, 2] = 1.0 / near
            count += 1
    p = polygon
    for k in range(2, count):
        area = (p[k - 1, 0] - p[0, 0]) * (p[k, 1] - p[0, 1]) - (p[k, 0] - p[0, 0]) * (p[k - 1, 1] - p[0, 1])
        if area < 0.0 or (two_sided and area > 0.0):
            _fill(
                inverse_depth, triangle, name,
                p[0, 0], p[0, 1], p[0, 2],
                p[k - 1, 0], p[k - 1, 1], p[k - 1, 2],
                p[k, 0], p[k, 1], p[k, 2], area,
            )  # fmt: skip


@_kernel
def rasterize(
    rotation: Array,
    centre: Array,
    focal: Array,
    near: float,
    far: float,
    vertices: Array,
    faces: Array,
    clusters: Array,
    entity_cluster: Array,
    entity_matrix: Array,
    entity_offset: Array,
    entity_sphere: Array,
    entity_two_sided: Array,
    inverse_depth: Array,
    triangle: Array,
) -> None:
    """Find the nearest triangle of every pixel.

    Args:
        rotation: (3, 3) world to camera.
        centre: (3,) camera in the world.
        focal: (4,) fx, fy, cx, cy.
        near: Triangles are clipped at this depth.
        far: Clusters wholly beyond this depth are skipped; single pixels beyond it are left to the caller.
        vertices: (3, V) float32, each cluster's own vertices in its own frame.
        faces: (F, 3) uint16, indices into the cluster's vertices.
        clusters: (C, 4) int32, first vertex, vertices, first face, faces.
        entity_cluster: (E,) int32.
        entity_matrix: (E, 3, 3) float32, cluster to world axes with the scale in it.
        entity_offset: (E, 3) float64, the cluster's origin in the world.
        entity_sphere: (E, 4) float64, bounding centre in the world and radius.
        entity_two_sided: (E,) bool.
        inverse_depth: (H, W) float32, zeros; written.
        triangle: (H, W) int32, `NOTHING`; written.
    """
    height, width = inverse_depth.shape
    fx, fy, cx, cy = focal[0], focal[1], focal[2], focal[3]
    # Half-widths of the frustum towards each side, per metre of depth, and the length of each side's normal.
    tan_left, tan_right = cx / fx, (width - cx) / fx
    tan_top, tan_bottom = cy / fy, (height - cy) / fy
    norm_left, norm_right = math.sqrt(1.0 + tan_left**2), math.sqrt(1.0 + tan_right**2)
    norm_top, norm_bottom = math.sqrt(1.0 + tan_top**2), math.sqrt(1.0 + tan_bottom**2)
    most = 0
    for c in range(clusters.shape[0]):
        most = max(most, clusters[c, 1])
    xs, ys, ws = np.empty(most, np.float32), np.empty(most, np.float32), np.empty(most, np.float32)
    cells = np.empty(most, np.int32)
    keep = np.empty(1 << FACE_BITS, np.uint16)
    m = np.empty((3, 3))
    corners = np.empty((3, 3))
    r = rotation
    for e in range(entity_cluster.shape[0]):
        px, py, pz = (
            entity_sphere[e, 0] - centre[0],
            entity_sphere[e, 1] - centre[1],
            entity_sphere[e, 2] - centre[2],
        )
        radius = entity_sphere[e, 3]
        qz = r[2, 0] * px + r[2, 1] * py + r[2, 2] * pz
        if qz < near - radius or qz > far + radius:
            continue
        qx = r[0, 0] * px + r[0, 1] * py + r[0, 2] * pz
        if qx - tan_right * qz > radius * norm_right or -qx - tan_left * qz > radius * norm_left:
            continue
        qy = r[1, 0] * px + r[1, 1] * py + r[1, 2] * pz
        if qy - tan_bottom * qz > radius * norm_bottom or -qy - tan_top * qz > radius * norm_top:
            continue

        # Cluster to camera, and with the intrinsics folded in, cluster to homogeneous pixels.
        for i in range(3):
            for j in range(3):
                m[i, j] = (
                    r[i, 0] * entity_matrix[e, 0, j]
                    + r[i, 1] * entity_matrix[e, 1, j]
                    + r[i, 2] * entity_matrix[e, 2, j]
                )
        ox, oy, oz = (
            entity_offset[e, 0] - centre[0],
            entity_offset[e, 1] - centre[1],
            entity_offset[e, 2] - centre[2],
        )
        tx = r[0, 0] * ox + r[0, 1] * oy + r[0, 2] * oz
        ty = r[1, 0] * ox + r[1, 1] * oy + r[1, 2] * oz
        tz = r[2, 0] * ox + r[2, 1] * oy + r[2, 2] * oz
        cluster = entity_cluster[e]
        first, count = clusters[cluster, 0], clusters[cluster, 1]
        first_face, face_count = clusters[cluster, 2], clusters[cluster, 3]
        x00 = np.float32(fx * m[0, 0] + cx * m[2, 0])
        x01 = np.float32(fx * m[0, 1] + cx * m[2, 1])
        x02 = np.float32(fx * m[0, 2] + cx * m[2, 2])
        x03 = np.float32(fx * tx + cx * tz)
        y00 = np.float32(fy * m[1, 0] + cy * m[2, 0])
        y01 = np.float32(fy * m[1, 1] + cy * m[2, 1])
        y02 = np.float32(fy * m[1, 2] + cy * m[2, 2])
        y03 = np.float32(fy * ty + cy * tz)
        z00, z01, z02, z03 = np.float32(m[2, 0]), np.float32(m[2, 1]), np.float32(m[2, 2]), np.float32(tz)
        vx, vy, vz = (
            vertices[0, first : first + count],
            vertices[1, first : first + count],
            vertices[2, first : first + count],
        )
        for k in range(count):
            w = np.float32(1.0) / (z00 * vx[k] + z01 * vy[k] + z02 * vz[k] + z03)
            xs[k] = (x00 * vx[k] + x01 * vy[k] + x02 * vz[k] + x03) * w
            ys[k] = (y00 * vx[k] + y01 * vy[k] + y02 * vz[k] + y03) * w
            ws[k] = w
        _cells(count, xs, ys, cells)
        two_sided = entity_two_sided[e]
        crosses = qz - radius < near
        nearest = np.float32(1.0 / near)
        # Most triangles of a far clump show their back or lie between the centres of pixels. They are
        # sorted out without branches, which the processor could not foresee.
        kept = 0
        for f in range(face_count):
            i0, i1, i2 = faces[first_face + f, 0], faces[first_face + f, 1], faces[first_face + f, 2]
            x0, x1, x2 = xs[i0], xs[i1], xs[i2]
            y0, y1, y2 = ys[i0], ys[i1], ys[i2]
            apart = (cells[i0] ^ cells[i1]) | (cells[i0] ^ cells[i2])
            spans = ((apart & 0xFFFF) != 0) & ((apart >> 16) != 0)
            area = np.float64(x1 - x0) * np.float64(y2 - y0) - np.float64(x2 - x0) * np.float64(y1 - y0)
            keep[kept] = f
            kept += crosses | (spans & ((area < 0.0) | two_sided))
        for k in range(kept):
            f = int(keep[k])
            i0, i1, i2 = faces[first_face + f, 0], faces[first_face + f, 1], faces[first_face + f, 2]
            w0, w1, w2 = ws[i0], ws[i1], ws[i2]
            if crosses:
                # Behind the camera w is negative, and nearer than the near plane it is large.
                in0, in1, in2 = 0.0 < w0 <= nearest, 0.0 < w1 <= nearest, 0.0 < w2 <= nearest
                if not (in0 or in1 or in2):
                    continue
                if not (in0 and in1 and in2):
                    for j in range(3):
                        i = i0 if j == 0 else (i1 if j == 1 else i2)
                        corners[j, 0] = m[0, 0] * vx[i] + m[0, 1] * vy[i] + m[0, 2] * vz[i] + tx
                        corners[j, 1] = m[1, 0] * vx[i] + m[1, 1] * vy[i] + m[1, 2] * vz[i] + ty
                        corners[j, 2] = m[2, 0] * vx[i] + m[2, 1] * vy[i] + m[2, 2] * vz[i] + tz
                    name = (e << FACE_BITS) | f
                    _fill_clipped(inverse_depth, triangle, name, corners, focal, near, two_sided)
                    continue
            x0, x1, x2 = xs[i0], xs[i1], xs[i2]
            y0, y1, y2 = ys[i0], ys[i1], ys[i2]
            area = np.float64(x1 - x0) * np.float64(y2 - y0) - np.float64(x2 - x0) * np.float64(y1 - y0)
            # Counter-clockwise from outside is clockwise on the screen, whose y points down.
            if area < 0.0 or (two_sided and area > 0.0):
                name = (e << FACE_BITS) | f
                _fill(inverse_depth, triangle, name, x0, y0, w0, x1, y1, w1, x2, y2, w2, area)


@_kernel
def resolve(
    inverse_depth: Array,
    triangle: Array,
    far: float,
    clusters: Array,
    entity_cluster: Array,
    entity_label: Array,
    entity_id: Array,
    face_id: Array,
    depth: Array,
    labels: Array,
    ids: Array,
) -> None:
    """Depth, label and id of every pixel; what lies beyond `far` becomes water, also in `triangle`.

    `face_id` (F,) is added to the entity's id; it tells the individuals of one merged mesh apart.
    """
    height, width = inverse_depth.shape
    least = np.float32(1.0 / far)
    for v in range(height):
        for u in range(width):
            w = inverse_depth[v, u]
            if w < least:
                triangle[v, u] = NOTHING
                depth[v, u] = np.nan
                labels[v, u] = 0
                ids[v, u] = -1
                continue
            depth[v, u] = np.float32(1.0) / w
            name = triangle[v, u]
            e = name >> FACE_BITS
            labels[v, u] = entity_label[e]
            face = clusters[entity_cluster[e], 2] + (name & ((1 << FACE_BITS) - 1))
            ids[v, u] = entity_id[e] + face_id[face]


# Shading works on lists of a few thousand pixels that show a surface, one step for all of them at a time:
# short loops that write few arrays are vectorised, and look-ups of many pixels wait for memory together.
LIST = 3072


@_kernel
def _fixed(
    count: Number, p: Array, z: Array, drift: Number, scale: Number, offset: Number, most: Number, out: Array
) -> None:
    """(p − z·drift)·scale + offset within [0, most] as an integer; coordinates in sixteenths of a texel."""
    for i in range(count):
        out[i] = np.int32(min(max((p[i] - z[i] * drift) * scale + offset, 0.0), most))


@_kernel
def _levels(
    count: Number, depth_bits: Array, phases: Array, rise: Array, start: Number, slant: Number, most: Number,
    out: Array,
) -> None:  # fmt: skip
    """Level of a pyramid where a texel is as wide as a pixel: start + log2(depth) + slant·rise, dithered.

    Neighbouring pixels choose neighbouring levels alternately, which hides the change. The bits of a float32,
    read as an integer, are its logarithm to within 0.09.
    """
    for i in range(count):
        level = depth_bits[i] * np.float32(2.0**-23) + np.float32(start - 127.0) + np.float32(slant) * rise[i]
        level += np.float32(0.25) * np.float32(phases[i])
        out[i] = np.int32(min(max(level, np.float32(0.0)), np.float32(most)))


@_kernel
def _seabed_light(
    count: Number, place: Array, fine: Array, focus: Array, sun: Array, texture: Number, out: Array
) -> None:
    """Light that a point of the seabed meets, times its tone, from its map and sand texels and caustics."""
    half, one, unit = np.float32(0.5), np.float32(1.0), np.float32(1.0 / 65280.0)
    sun_x, sun_y, sun_z = np.float32(sun[0]), np.float32(sun[1]), np.float32(sun[2])
    texture = np.float32(texture)
    ambient, direct = np.float32(AMBIENT), np.float32(DIRECT)
    for i in range(count):
        here, near = place[i], fine[i]
        open_sky = unit * np.float32(np.int32((here >> 32) & 0xFFFF))
        slope_x = unit * np.float32(np.int32(here & 0xFFFF)) - half
        slope_y = unit * np.float32(np.int32((here >> 16) & 0xFFFF)) - half
        slope_x += texture * (unit * np.float32(np.int32((near >> 32) & 0xFFFF)) - half)
        slope_y += texture * (unit * np.float32(np.int32((near >> 48) & 0xFFFF)) - half)
        slope_x, slope_y = slope_x + slope_x, slope_y + slope_y
        tone = unit * np.float32(np.int32(near & 0xFFFF)) - half
        tone = one + texture * (tone + tone)
        upright = one / np.float32(math.sqrt(one + slope_x * slope_x + slope_y * slope_y))
        facing = max(sun_z - sun_x * slope_x - sun_y * slope_y, np.float32(0.0)) * upright
        sky = ambient * open_sky * (half + half * upright)
        out[i] = tone * (sky + direct * facing * focus[i] * (np.float32(0.35) + np.float32(0.65) * open_sky))


@_inlined
def lane(texel: Number, channel: Number) -> Number:
    """One channel of a blended texel, in [0, 1]."""
    return np.float32(np.int32((texel >> (16 * channel)) & 0xFFFF)) * np.float32(1.0 / 65280.0)


@_inlined
def _glow(rise: Number) -> Number:
    """Open water is brighter towards the surface and darker towards the deep."""
    return min(max(np.float32(1.0) + np.float32(0.75) * rise, np.float32(0.45)), np.float32(2.2))


@_inlined
def _clamped(value: Number) -> Number:
    return min(max(value, np.float32(0.0)), np.float32(1.0))


@_inlined
def _mixed(a: Number, b: Number, share: Number) -> Number:
    return a + share * (b - a)


@_inlined
def _tiled(texels: Array, starts: Array, bits: Number, level: Number, x: Number, y: Number) -> Number:
    """Blend of the four texels about (x, y) of one level of 2^`bits` tiles: lanes of sixteen bits.

    The coordinates are in sixteenths of a texel of level 0. All is unsigned, so that no index is negative.
    """
    level = np.uint32(level)
    # The middle of a texel has its value. A whole tile more keeps it positive.
    half = np.uint32(8) << level
    x, y = (np.uint32(x) - half) >> level, (np.uint32(y) - half) >> level
    sx, sy = np.int64(x & np.uint32(15)), np.int64(y & np.uint32(15))
    side = np.uint32(bits) - level
    mask = (np.uint32(1) << side) - np.uint32(1)
    column, row = x >> np.uint32(4), y >> np.uint32(4)
    c0, c1 = column & mask, (column + np.uint32(1)) & mask
    start = np.uint32(starts[level])
    r0 = start + ((row & mask) << side)
    r1 = start + (((row + np.uint32(1)) & mask) << side)
    # The weights add up to 256, so that four lanes blend at once and none runs into the next.
    across = sx * sy
    blended: Number = (
        texels[np.uint32(r0 + c0)] * (256 - 16 * (sx + sy) + across)
        + texels[np.uint32(r0 + c1)] * (16 * sx - across)
        + texels[np.uint32(r1 + c0)] * (16 * sy - across)
        + texels[np.uint32(r1 + c1)] * across
    )
    return blended


@_inlined
def _mapped(texels: Array, x: Number, y: Number) -> Number:
    """Blend of the four map points about (x, y), in sixteenths of their spacing and within the map."""
    column, row = np.uint32(x) >> np.uint32(4), np.uint32(y) >> np.uint32(4)
    sx, sy = np.int64(x & 15), np.int64(y & 15)
    next_column, next_row = np.uint32(column + np.uint32(1)), np.uint32(row + np.uint32(1))
    across = sx * sy
    blended: Number = (
        texels[row, column] * (256 - 16 * (sx + sy) + across)
        + texels[row, next_column] * (16 * sx - across)
        + texels[next_row, column] * (16 * sy - across)
        + texels[next_row, next_column] * across
    )
    return blended


@_kernel
def _ground(
    count: Number, pixels: Array, materials: Array, texels: Array, map_x: Array, map_y: Array, place: Array
) -> None:
    """The map's texel at each pixel; the map is smooth, so that neighbours share it in pairs."""
    for i in range(count):
        if i & 1 == 0 or pixels[i] != pixels[i - 1] + 1 or materials[i] != materials[i - 1]:
            place[i] = _mapped(texels, map_x[i], map_y[i])
        else:
            place[i] = place[i - 1]


@_kernel
def _texture(
    count: Number, texels: Array, starts: Array, bits: Number, levels: Array, x: Array, y: Array, out: Array
) -> None:
    """The blended texel of each pixel."""
    for i in range(count):
        out[i] = _tiled(texels, starts, bits, levels[i], x[i], y[i])


@_kernel
def _focus(
    count: Number, texels: Array, z: Array, low: Number, step: Number, light: Array, out: Array
) -> None:
    """How much more light than the mean the waves throw on each pixel."""
    last = light.shape[0] - 1
    for i in range(count):
        row = min(max(int((z[i] - low) * step), 0), last)
        out[i] = np.float32(1.0) + light[row, 3] * (np.float32(4.0) * lane(texels[i], 0) - np.float32(1.0))


@_kernel
def _rays(
    start: Number, step: Number, across: Number, lean: Number, turn: Number, stretch: Array, rise: Array
) -> None:
    """Length of each ray of a row per metre of depth, and the sine of its climb.

    A ray is start + step·column to the right and `across` in the row's direction of the camera's axes, and
    climbs lean + turn·(right) per metre of depth.
    """
    for u in range(len(rise)):
        right = start + step * u
        length = math.sqrt(1.0 + right * right + across * across)
        stretch[u] = length
        rise[u] = (lean + turn * right) / length


@_kernel
def _surfaces(
    v: Number, count: Number, solids: Number, triangle: Array, depth: Array, entity_material: Array,
    eye: Array, base: Array, step: Array, stretch: Array, rise: Array, veil: Array, encode: Array,
    pixels: Array,
    phases: Array, names: Array, materials: Array, depths: Array,
    lengths: Array, slants: Array, px: Array, py: Array, pz: Array, rgb: Array,
) -> tuple[int, int]:  # fmt: skip
    """Colour the open water of a row and append its other pixels to the list.

    Returns how long the list is now, and how many of it are meshes.
    """
    full = np.float32(4095.0)
    red, green, blue = np.float32(veil[0]) * full, np.float32(veil[1]) * full, np.float32(veil[2]) * full
    eye_x, eye_y, eye_z = eye[0], eye[1], eye[2]
    base_x, base_y, base_z = base[0], base[1], base[2]
    step_x, step_y, step_z = step[0], step[1], step[2]
    width = triangle.shape[1]
    for u in range(width):
        name, pixel = triangle[v, u], v * width + u
        if name < 0:
            glow = _glow(rise[u])
            rgb[pixel, 0] = encode[min(np.uint32(red * glow), np.uint32(4095))]
            rgb[pixel, 1] = encode[min(np.uint32(green * glow), np.uint32(4095))]
            rgb[pixel, 2] = encode[min(np.uint32(blue * glow), np.uint32(4095))]
        else:
            material, z = entity_material[np.uint32(name) >> np.uint32(FACE_BITS)], depth[v, u]
            pixels[count], names[count], materials[count] = pixel, name, material
            phases[count], slants[count] = (u + 2 * v) & 3, rise[u]
            depths[count], lengths[count] = z, z * stretch[u]
            px[count] = eye_x + z * (base_x + step_x * u)
            py[count] = eye_y + z * (base_y + step_y * u)
            pz[count] = eye_z + z * (base_z + step_z * u)
            count += 1
            solids += material != SEABED
    return count, solids


@_kernel
def _seabed_growth(
    count: Number, place: Array, fine: Array, texture: Number, grown: Number, out: Array
) -> None:
    """Share of the seabed that is grown over."""
    half, texture, grown = np.float32(0.5), np.float32(texture), np.float32(grown)
    for i in range(count):
        share = lane(place[i], 3) - half + texture * (lane(fine[i], 0) - half)
        out[i] = grown * _clamped(share * np.float32(3.0) + np.float32(0.3))


@_kernel
def _seabed_colour(
    count: Number,
    fine: Array,
    bright: Array,
    growth: Array,
    bare: Number,
    alive: Number,
    chips: Number,
    out: Array,
) -> None:
    """One channel of what the seabed sends back of white light; `chips` is what shell hash adds."""
    bare, alive, chips = np.float32(bare), np.float32(alive), np.float32(chips)
    for i in range(count):
        out[i] = bright[i] * (_mixed(bare, alive, growth[i]) + chips * lane(fine[i], 1))


@_kernel
def _solids(
    count: Number, eye: Array, names: Array, materials: Array, px: Array, py: Array, pz: Array, levels: Array,
    place: Array, focus: Array, clusters: Array, face_shade: Array, entity_cluster: Array, inverse: Array,
    offset: Array, two_sided: Array, tint: Array, foot: Array,
    stone: Array, stone_starts: Array, bits: Number, per_stone: Number, sun: Array, colour: Array,
) -> None:  # fmt: skip
    """What the points of meshes send back of white light."""
    before = 1.0 * (1 << (bits + 4 + BEFORE_BITS))
    zero, half, one = np.float32(0.0), np.float32(0.5), np.float32(1.0)
    sun_x, sun_y, sun_z = np.float32(sun[0]), np.float32(sun[1]), np.float32(sun[2])
    eye_x, eye_y, eye_z = np.float32(eye[0]), np.float32(eye[1]), np.float32(eye[2])
    for i in range(count):
        material = materials[i]
        if material == SEABED:
            continue
        name = np.uint32(names[i])
        e = np.uint32(name >> np.uint32(FACE_BITS))
        face = np.uint32(
            np.uint32(clusters[entity_cluster[e], 2]) + np.uint32(name & np.uint32((1 << FACE_BITS) - 1))
        )
        s = face_shade
        x, y, z = px[i], py[i], pz[i]
        ox, oy, oz = np.float32(x - offset[e, 0]), np.float32(y - offset[e, 1]), np.float32(z - offset[e, 2])
        m00, m01, m02 = inverse[e, 0, 0], inverse[e, 0, 1], inverse[e, 0, 2]
        m10, m11, m12 = inverse[e, 1, 0], inverse[e, 1, 1], inverse[e, 1, 2]
        m20, m21, m22 = inverse[e, 2, 0], inverse[e, 2, 1], inverse[e, 2, 2]
        qx = m00 * ox + m01 * oy + m02 * oz - s[face, 0]
        qy = m10 * ox + m11 * oy + m12 * oz - s[face, 1]
        qz = m20 * ox + m21 * oy + m22 * oz - s[face, 2]
        b1 = s[face, 3] * qx + s[face, 4] * qy + s[face, 5] * qz
        b2 = s[face, 6] * qx + s[face, 7] * qy + s[face, 8] * qz
        hx = s[face, 9] + b1 * s[face, 12] + b2 * s[face, 15]
        hy = s[face, 10] + b1 * s[face, 13] + b2 * s[face, 16]
        hz = s[face, 11] + b1 * s[face, 14] + b2 * s[face, 17]
        red = (s[face, 18] + b1 * s[face, 21] + b2 * s[face, 24]) * tint[e, 0]
        green = (s[face, 19] + b1 * s[face, 22] + b2 * s[face, 25]) * tint[e, 1]
        blue = (s[face, 20] + b1 * s[face, 23] + b2 * s[face, 26]) * tint[e, 2]
        # A normal goes over to the world by the transpose of the inverse.
        nx = m00 * hx + m10 * hy + m20 * hz
        ny = m01 * hx + m11 * hy + m21 * hz
        nz = m02 * hx + m12 * hy + m22 * hz
        unit = one / np.float32(math.sqrt(nx * nx + ny * ny + nz * nz + np.float32(1e-20)))
        if two_sided[e] and nx * (x - eye_x) + ny * (y - eye_y) + nz * (z - eye_z) > zero:
            unit = -unit
        nx, ny, nz = nx * unit, ny * unit, nz * unit
        # The texture is laid on along the axis that the surface faces most.
        flat_x, flat_y, flat_z = abs(nx), abs(ny), abs(nz)
        across = y if flat_x >= flat_y and flat_x > flat_z else x
        along = y if flat_z >= flat_x and flat_z >= flat_y else z
        # Shells are three times as fine.
        finer = material == SHELL
        scale = 3.0 * per_stone if finer else per_stone
        level = min(levels[i] + (2 if finer else 0), bits)
        fine = _tiled(
            stone, stone_starts, bits, level, int(across * scale + before), int(along * scale + before)
        )
        if material == SHELL:
            tone = np.float32(0.6) + np.float32(1.1) * lane(fine, 1)
            contact_scale = np.float32(1.0 / 0.14)
        elif material == ROCK:
            # Silt and turf settle on what faces up.
            tone = np.float32(0.3) + np.float32(1.4) * lane(fine, 0)
            contact_scale = np.float32(1.0 / 0.6)
            turf = np.float32(0.6) * _clamped(nz * np.float32(1.6) - np.float32(1.2) + lane(fine, 2))
            red, green = _mixed(red, np.float32(0.16), turf), _mixed(green, np.float32(0.15), turf)
            blue = _mixed(blue, np.float32(0.07), turf)
        elif material == WOOD and red < np.float32(RUSTY) * green:
            # Bored and cracked; what lives on it is patchy, and thicker where light falls.
            tone = (np.float32(0.45) + np.float32(0.8) * lane(fine, 0)) * (
                np.float32(0.65) + np.float32(0.7) * lane(fine, 3)
            )
            contact_scale = np.float32(1.0 / 0.6)
            growth = half * _clamped((lane(fine, 2) - half) * np.float32(2.5) + half * nz)
            red, green = _mixed(red, np.float32(0.14), growth), _mixed(green, np.float32(0.15), growth)
            blue = _mixed(blue, np.float32(0.085), growth)
        elif material in (HULL, WOOD):
            tone = np.float32(0.55) + np.float32(0.9) * lane(fine, 3)
            contact_scale = np.float32(1.0 / 0.9)
            rust = np.float32(0.8) * _clamped(lane(fine, 2) * np.float32(2.0) - one)
            red, green = _mixed(red, np.float32(0.30), rust), _mixed(green, np.float32(0.115), rust)
            blue = _mixed(blue, np.float32(0.05), rust)
        else:
            tone = np.float32(0.95) + np.float32(0.1) * lane(fine, 2)
            contact_scale = np.float32(1.0 / 0.3)
        contact = _clamped((z - foot[e]) * contact_scale)
        shelter = _mixed(lane(place[i], 2), one, contact) * (np.float32(0.6) + np.float32(0.4) * contact)
        facing = max(nx * sun_x + ny * sun_y + nz * sun_z, zero)
        # Light from above, what the seabed throws back from below, and the sun.
        sky = (np.float32(0.32) + np.float32(0.18) * nz) * shelter + np.float32(0.08)
        open_to_sun = np.float32(0.4) + np.float32(0.6) * shelter
        bright = tone * (sky + np.float32(DIRECT) * facing * focus[i] * open_to_sun)
        colour[0, i], colour[1, i], colour[2, i] = red * bright, green * bright, blue * bright


@_kernel
def _behind_water(
    count: Number, pixels: Array, depths: Array, lengths: Array, slants: Array, z: Array, low: Number,
    step: Number, light: Array, water: Array, water_step: Number, veil: Array, encode: Array,
    colour: Array, rgb: Array,
) -> None:  # fmt: skip
    """Light the pixels by the day at their height, put the water before them and write them."""
    full, per_metre, low, step = np.float32(4095.0), np.float32(water_step), np.float32(low), np.float32(step)
    veil_red, veil_green, veil_blue = np.float32(veil[0]), np.float32(veil[1]), np.float32(veil[2])
    last_water, last_light = np.uint32(water.shape[0] - 1), np.int32(light.shape[0] - 1)
    for i in range(count):
        row = np.uint32(min(max(np.int32((z[i] - low) * step), np.int32(0)), last_light))
        far = min(np.uint32(lengths[i] * per_metre), last_water)
        left = water[min(np.uint32(depths[i] * per_metre), last_water), 6]
        glow = _glow(slants[i])
        red, green, blue = veil_red * glow, veil_green * glow, veil_blue * glow
        red += left * (colour[0, i] * light[row, 0] * water[far, 0] - red * water[far, 3])
        green += left * (colour[1, i] * light[row, 1] * water[far, 1] - green * water[far, 4])
        blue += left * (colour[2, i] * light[row, 2] * water[far, 2] - blue * water[far, 5])
        pixel = np.uint32(pixels[i])
        rgb[pixel, 0] = encode[min(np.uint32(red * full), np.uint32(4095))]
        rgb[pixel, 1] = encode[min(np.uint32(green * full), np.uint32(4095))]
        rgb[pixel, 2] = encode[min(np.uint32(blue * full), np.uint32(4095))]


@_kernel
def shade(
    triangle: Array,
    depth: Array,
    rotation: Array,
    centre: Array,
    focal: Array,
    clusters: Array,
    face_shade: Array,
    entity_cluster: Array,
    entity_inverse: Array,
    entity_offset: Array,
    entity_two_sided: Array,
    entity_material: Array,
    entity_tint: Array,
    entity_foot: Array,
    ground: Array,
    ground_frame: Array,
    sand: Array,
    sand_starts: Array,
    stone: Array,
    stone_starts: Array,
    caustics: Array,
    caustic_starts: Array,
    tiles: Array,
    light: Array,
    light_frame: Array,
    sun: Array,
    water: Array,
    water_step: float,
    veil: Array,
    seabed: Array,
    encode: Array,
    rgb: Array,
) -> None:
    """Colour each pixel once: albedo by material and place, light, then the water in front of it.

    Args:
        triangle: (H, W) int32 of `rasterize`, after `resolve`.
        depth: (H, W) float32 metres; NaN where there is only water.
        rotation: (3, 3) camera to world.
        centre: (3,) camera in the world.
        focal: (4,) fx, fy, cx, cy.
        clusters: Arrays of `Scene` of the same names, down to `entity_tint`.
        face_shade: See `clusters`.
        entity_cluster: See `clusters`.
        entity_inverse: See `clusters`.
        entity_offset: See `clusters`.
        entity_two_sided: See `clusters`.
        entity_material: See `clusters`.
        entity_tint: See `clusters`.
        entity_foot: (E,) float32, world z of the seabed beneath it.
        ground: (R, C) int64 of `GroundMap`.
        ground_frame: (3,) x0, y0 and points per metre.
        sand: Texels of a `Pyramid`.
        sand_starts: Where its levels start.
        stone: See `sand`.
        stone_starts: See `sand`.
        caustics: See `sand`.
        caustic_starts: See `sand`.
        tiles: (3, 2), of sand, stone and caustics: log2 of the texels along a side, tiles per metre.
        light: (L, 4) float32, colour of the light from above and contrast of the caustics by height.
        light_frame: (2,) world z of the first row of `light`, rows per metre.
        sun: (3,) unit vector towards the light.
        water: (T, 7) float32: by ray length the direct light (3) and what the veil lacks (3); by depth the
            share not yet faded.
        water_step: Rows of `water` per metre.
        veil: (3,) colour of open water at the horizon.
        seabed: (4, 3) of `Shading`.
        encode: (4096,) uint8, sRGB of linear light.
        rgb: (H, W, 3) uint8; written.
    """
    height, width = triangle.shape
    sand_bits, stone_bits, caustic_bits = int(tiles[0, 0]), int(tiles[1, 0]), int(tiles[2, 0])
    # Sixteenths of a texel per metre.
    per_sand = tiles[0, 1] * (1 << (sand_bits + 4))
    per_stone = tiles[1, 1] * (1 << (stone_bits + 4))
    per_caustic = tiles[2, 1] * (1 << (caustic_bits + 4))
    map_scale = 16.0 * ground_frame[2]
    # log2 of texels per metre and pixels per radian.
    pixel_log = -math.log2(focal[0])
    sand_log = pixel_log + sand_bits + math.log2(tiles[0, 1])
    stone_log = pixel_log + stone_bits + math.log2(tiles[1, 1])
    caustic_log = pixel_log + caustic_bits + math.log2(tiles[2, 1])
    shift_x, shift_y = sun[0] / sun[2], sun[1] / sun[2]
    inverse_fx, inverse_fy = 1.0 / focal[0], 1.0 / focal[1]
    start_x = (0.5 - focal[2]) * inverse_fx
    last_map_x, last_map_y = 16.0 * ground.shape[1] - 17.0, 16.0 * ground.shape[0] - 17.0
    before_sand = 1.0 * (1 << (sand_bits + 4 + BEFORE_BITS))
    before_caustic = 1.0 * (1 << (caustic_bits + 4 + BEFORE_BITS))

    size = max(LIST, width)
    stretch, rise = np.empty(width, np.float32), np.empty(width, np.float32)
    pixels, phases, names = np.empty(size, np.int32), np.empty(size, np.int32), np.empty(size, np.int32)
    materials = np.empty(size, np.uint8)
    depths, lengths = np.empty(size, np.float32), np.empty(size, np.float32)
    depth_bits, slants = depths.view(np.int32), np.empty(size, np.float32)
    px, py, pz = np.empty(size, np.float32), np.empty(size, np.float32), np.empty(size, np.float32)
    tile_x, tile_y, levels = np.empty(size, np.int32), np.empty(size, np.int32), np.empty(size, np.int32)
    fine, place = np.empty(size, np.int64), np.empty(size, np.int64)
    focus, bright, growth = np.empty(size, np.float32), np.empty(size, np.float32), np.empty(size, np.float32)
    colour = np.empty((3, size), np.float32)
    base, step = np.empty(3), np.empty(3)
    flat_rgb = rgb.reshape(height * width, 3)

    count = solids = 0
    for v in range(height):
        yc = (v + 0.5 - focal[3]) * inverse_fy
        for k in range(3):
            step[k] = rotation[k, 0] * inverse_fx
            base[k] = rotation[k, 1] * yc + rotation[k, 2] + rotation[k, 0] * start_x
        lean = rotation[2, 1] * yc + rotation[2, 2]
        _rays(start_x, inverse_fx, yc, lean, rotation[2, 0], stretch, rise)
        count, solids = _surfaces(
            v, count, solids, triangle, depth, entity_material, centre, base, step, stretch, rise, veil,
            encode, pixels, phases, names, materials, depths, lengths, slants, px, py, pz, flat_rgb,
        )  # fmt: skip
        if count == 0 or (v < height - 1 and count + width <= size):
            continue

        # The pattern of the caustics is carried down along the sun's rays.
        _fixed(count, px, pz, shift_x, per_caustic, before_caustic, ANYWHERE, tile_x)
        _fixed(count, py, pz, shift_y, per_caustic, before_caustic, ANYWHERE, tile_y)
        _levels(count, depth_bits, phases, slants, caustic_log, 0.0, caustic_bits, levels)
        _texture(count, caustics, caustic_starts, caustic_bits, levels, tile_x, tile_y, fine)
        _focus(count, fine, pz, light_frame[0], light_frame[1], light, focus)

        _fixed(count, px, pz, 0.0, map_scale, -ground_frame[0] * map_scale, last_map_x, tile_x)
        _fixed(count, py, pz, 0.0, map_scale, -ground_frame[1] * map_scale, last_map_y, tile_y)
        _ground(count, pixels, materials, ground, tile_x, tile_y, place)

        if solids < count:
            _fixed(count, px, pz, 0.0, per_sand, before_sand, ANYWHERE, tile_x)
            _fixed(count, py, pz, 0.0, per_sand, before_sand, ANYWHERE, tile_y)
            # Seen at a slant a pixel covers more ground.
            _levels(count, depth_bits, phases, slants, sand_log + 1.0, 1.0, sand_bits, levels)
            _texture(count, sand, sand_starts, sand_bits, levels, tile_x, tile_y, fine)
            _seabed_light(count, place, fine, focus, sun, seabed[3, 0], bright)
            _seabed_growth(count, place, fine, seabed[3, 0], seabed[3, 1], growth)
            for k in range(3):
                chips = seabed[3, 0] * seabed[2, k]
                _seabed_colour(count, fine, bright, growth, seabed[0, k], seabed[1, k], chips, colour[k])
        if solids > 0:
            _levels(count, depth_bits, phases, slants, stone_log, 0.0, 30.0, levels)
            _solids(
                count, centre, names, materials, px, py, pz, levels, place, focus, clusters, face_shade,
                entity_cluster, entity_inverse, entity_offset, entity_two_sided, entity_tint, entity_foot,
                stone, stone_starts, stone_bits, per_stone, sun, colour,
            )  # fmt: skip
        _behind_water(
            count, pixels, depths, lengths, slants, pz, light_frame[0], light_frame[1], light, water,
            water_step, veil, encode, colour, flat_rgb,
        )  # fmt: skip
        count = solids = 0


@_kernel
def snow(depth: Array, focal: Array, flakes: Array, size: float, color: Array, rgb: Array) -> None:
    """Draw soft flakes (N, 3), in camera axes and `size` metres across, over what lies behind them."""
    height, width = depth.shape
    for i in range(flakes.shape[0]):
        z = flakes[i, 2]
        if z < 0.25:
            continue
        x, y = focal[0] * flakes[i, 0] / z + focal[2] - 0.5, focal[1] * flakes[i, 1] / z + focal[3] - 0.5
        if not (-4.0 < x < width + 3.0 and -4.0 < y < height + 3.0):
            continue
        # One that is smaller than a pixel covers less than all of it; a near one is out of focus.
        across = size * focal[0] / z
        spread = max(0.5 * across, 0.6)
        cover = 0.5 * min(0.25 * across * across / (spread * spread), 1.0)
        reach = int(2.0 * spread) + 1
        for v in range(max(int(y) - reach, 0), min(int(y) + reach + 2, height)):
            for u in range(max(int(x) - reach, 0), min(int(x) + reach + 2, width)):
                if depth[v, u] < z:
                    continue
                fall = ((u - x) ** 2 + (v - y) ** 2) / (spread * spread)
                share = cover * math.exp(-fall)
                for k in range(3):
                    rgb[v, u, k] = np.uint8(rgb[v, u, k] + share * (color[k] - rgb[v, u, k]))
