"""Screen-space depth, thickness and color of a liquid's front surface.

Every particle is a ball. The nearest balls make the front, which a narrow-range filter smooths:
pixels farther by more than a threshold belong to another object and are replaced by their mirror
image across the pixel, so that edges are not bent; nearer ones are clamped to a slightly nearer
depth. Sums over all balls in front of the background give the path length through the liquid and
its color. Inverse depths, `inv_depth` [1/m], are 0 where there is no liquid. `lens` holds fx, fy,
cx, cy [pixels] and the near plane [m]; `w2c` (4, 4) transforms from the world to the camera.

References:
    N. Truong, C. Yuksel. A narrow-range filter for screen-space fluid rendering. 2018.
"""

import numpy as np

from vgmpi.gaussians.camera import Camera
from vgmpi.runtime.compile_cache import njit_cached

BALL = 0.9  # [spacings] ball radius at which the front of a regular lattice has no holes
ABOVE = 0.3  # [spacings] mean height of the balls' front above the liquid's surface
SMOOTH = 1.2  # [spacings] standard deviation of the filter along the surface
RANGE = 5.0  # [spacings] depth difference above which two pixels show different objects
NEARER = 1.0  # [spacings] difference to which the depths of nearer objects are clamped
ROUNDS = 2  # [-] passes of the filter
STEP = 0.02  # [-] relative depth step between different objects behind the liquid
LANE = 16  # [pixels] SIMD width of the filter
_ZERO, _ONE = np.float32(0), np.float32(1)
SMALL = 3.0  # [pixels] ball radius in the coarse picture of the front
AVERAGING_PASSES = 8  # [-] passes of the 3 x 3 mean over coarse pixels
COVERED = 1.25  # [pixels] ball radius in the coarse picture of the thickness
MAX_HALF_WIDTH = 24  # [pixels] largest half width of the filter
RADIUS = (3 / (4 * np.pi)) ** (1 / 3)  # [spacings] radius of a ball of a particle's volume
FULL = 4  # [particles] count in a cell of two spacings that marks it as full


def is_interior(x: np.ndarray, spacing: float) -> np.ndarray:
    """Return a mask of the particles x (n, 3) [m] with too many neighbors to be at the surface."""
    if not len(x):
        return np.zeros(0, bool)
    edge = 2.0 * spacing
    cell = np.floor(x / edge).astype(np.int64)
    cell -= cell.min(axis=0) - 1
    shape = cell.max(axis=0) + 2
    if np.prod(shape.astype(float)) > 3e7:
        return np.zeros(len(x), bool)
    flat = np.ravel_multi_index(cell.T, shape)
    full = (np.bincount(flat, minlength=np.prod(shape)) >= FULL).reshape(shape)
    for axis in range(3):
        full = full & np.roll(full, 1, axis) & np.roll(full, -1, axis)
    return full.ravel()[flat]


def neighbor_fraction(x: np.ndarray, spacing: float) -> np.ndarray:
    """Return the neighbor count (n,) of particles x (n, 3) [m] relative to a liquid's bulk.

    Neighbors, the particle included, are counted in the 27 cells of 1.5 spacings around it.
    """
    if not len(x):
        return np.zeros(0)
    edge = 1.5 * spacing
    cell = np.floor(x / edge).astype(np.int64)
    code = cell - cell.min(axis=0) + 1
    shape = code.max(axis=0) + 2
    if np.prod(shape.astype(float)) > 3e7:
        return np.ones(len(x))
    flat = np.ravel_multi_index(code.T, shape)
    count = np.bincount(flat, minlength=np.prod(shape)).reshape(shape)
    for axis in range(3):
        count = count + np.roll(count, 1, axis) + np.roll(count, -1, axis)
    return count.ravel()[flat] / (3 * 1.5) ** 3


def liquid_depth(x: np.ndarray, radius: np.ndarray, spacing: float, camera: Camera) -> np.ndarray:
    """Return the smoothed depth of the front of balls along the camera axis.

    Args:
        x: Centers, shape (n, 3) [m].
        radius: Radii, shape (n,) [m].
        spacing: Distance of neighbors [m].
        camera: Camera of the picture.

    Returns:
        Depths, float32 (height, width) [m], infinite where there is no ball.
    """
    w2c, lens = _view(camera)
    factor = _downsampling_factor(x, radius, w2c, lens, 2, SMALL)
    coarse = lens / np.array([factor, factor, factor, factor, 1.0])
    height, width = -(-camera.height // factor), -(-camera.width // factor)
    depth = np.full((height, width), np.inf, dtype=np.float32)
    outer = ~is_interior(x, spacing)
    _nearest_ball_depth(x[outer], radius[outer], w2c, coarse, depth)
    margin = MAX_HALF_WIDTH
    row = width + 2 * margin + LANE
    inv_depth = np.zeros((height + 2 * margin, row), dtype=np.float32)
    inv_depth[margin : margin + height, margin : margin + width] = 1 / depth
    blur, limit = SMOOTH * spacing / np.sqrt(ROUNDS), np.float32(RANGE * spacing)
    for _ in range(ROUNDS):
        for step, focal in ((1, coarse[0]), (row, coarse[1])):
            beyond = NEARER * spacing
            sizes = step, margin, height, width, blur * focal, limit, beyond
            inv_depth = _narrow_range_filter(inv_depth.ravel(), *sizes).reshape(inv_depth.shape)
    result = np.ascontiguousarray(inv_depth[margin : margin + height, margin : margin + width])
    if factor > 1:
        fine = np.zeros((camera.height, camera.width), dtype=np.float32)
        _upsample_inverse_depth(result, factor, limit, fine)
        result = fine
    with np.errstate(divide="ignore"):
        return 1 / result


def _downsampling_factor(x, radius, w2c, lens, max_factor: int, target: float) -> int:
    """Return the factor of coarser pixels at which a ball's radius is `target` of them."""
    if not len(x):
        return 1
    depth = max(float(np.median(x @ w2c[2, :3] + w2c[2, 3])), lens[4])
    return int(np.clip(np.median(radius) * lens[0] / depth / target, 1, max_factor))


def liquid_thickness(
    x: np.ndarray,
    radius: np.ndarray,
    color: np.ndarray,
    opacity: np.ndarray,
    camera: Camera,
    back_depth: np.ndarray,
) -> np.ndarray:
    """Return path length, color and opacity of the balls in front of a background.

    Gaussians of a standard deviation r that are as dense as balls of radius r weaken light by
    3 opacity / (2 r) per m.

    Args:
        x: Centers, shape (n, 3) [m].
        radius: Radii, shape (n,) [m].
        color: Colors, shape (n, 3).
        opacity: Opacities as Gaussians, shape (n,).
        camera: Camera of the picture.
        back_depth: Depth of the background, shape (height, width) [m].

    Returns:
        Float32 (height, width, 5): path length through the balls [m], path length times red, green
        and blue, and the optical depth of the balls as (opaque) Gaussians.
    """
    w2c, lens = _view(camera)
    # the sums are smooth, so coarse pixels suffice; a ball covers several of them
    factor = _downsampling_factor(x, radius, w2c, lens, 8, COVERED)
    coarse = lens / np.array([factor, factor, factor, factor, 1.0])
    back_depth = np.ascontiguousarray(back_depth[factor // 2 :: factor, factor // 2 :: factor])
    sums = np.zeros((*back_depth.shape, 5), dtype=np.float32)
    _add_path_lengths(x, radius, color, 1.5 * opacity / radius, w2c, coarse, back_depth, sums)
    # rows of round balls leave a pattern; the mean over neighboring pixels removes it
    for _ in range(AVERAGING_PASSES):
        passed = np.zeros_like(sums)
        _box_average(sums, back_depth, passed)
        sums = passed
    out = np.empty((camera.height, camera.width, 5), dtype=np.float32)
    _upsample(sums, factor, out)
    return out


def _view(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return the world-to-camera matrix (4, 4) and the lens: fx, fy, cx, cy, near."""
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.near], dtype=np.float64)
    return np.ascontiguousarray(camera.world_to_camera, dtype=np.float64), lens


@njit_cached(nogil=True, error_model="numpy", inline="always")
def _extent(X, Y, Z, R, lens, height, width):
    """Return the first and last column and row that a ball may cover."""
    near_depth = max(Z - R, lens[4])
    slope, inverse_depth = R / near_depth, 1.0 / Z
    rx, ry = lens[0] * slope, lens[1] * slope
    px, py = lens[0] * X * inverse_depth + lens[2], lens[1] * Y * inverse_depth + lens[3]
    x0, x1 = max(0, int(np.floor(px - rx - 0.5))), min(width - 1, int(np.ceil(px + rx - 0.5)))
    y0, y1 = max(0, int(np.floor(py - ry - 0.5))), min(height - 1, int(np.ceil(py + ry - 0.5)))
    return x0, x1, y0, y1


@njit_cached(nogil=True, error_model="numpy")
def _nearest_ball_depth(x, radius, w2c, lens, depth):
    """Fill in the depth (height, width) [m] of the nearest ball."""
    height, width = depth.shape
    wide, high = 1.0 / lens[0], 1.0 / lens[1]
    for i in range(len(x)):
        a, b, c, R = x[i, 0], x[i, 1], x[i, 2], radius[i]
        Z = w2c[2, 0] * a + w2c[2, 1] * b + w2c[2, 2] * c + w2c[2, 3]
        if not (Z - R >= lens[4] and Z < 1e30):
            continue
        X = w2c[0, 0] * a + w2c[0, 1] * b + w2c[0, 2] * c + w2c[0, 3]
        Y = w2c[1, 0] * a + w2c[1, 1] * b + w2c[1, 2] * c + w2c[1, 3]
        x0, x1, y0, y1 = _extent(X, Y, Z, R, lens, height, width)
        power = X * X + Y * Y + Z * Z - R * R
        for j in range(y0, y1 + 1):
            v = (j + 0.5 - lens[3]) * high
            for k in range(x0, x1 + 1):
                u = (k + 0.5 - lens[2]) * wide
                square, along = u * u + v * v + 1.0, u * X + v * Y + Z
                root = along * along - square * power
                if root > 0.0:
                    z = np.float32((along - np.sqrt(root)) / square)
                    if z < depth[j, k]:
                        depth[j, k] = z


@njit_cached(nogil=True, error_model="numpy")
def _add_path_lengths(x, radius, color, extinction, w2c, lens, back_depth, sums):
    """Add the paths through balls in front of the background to sums (height, width, 5)."""
    height, width = back_depth.shape
    wide, high = 1.0 / lens[0], 1.0 / lens[1]
    for i in range(len(x)):
        a, b, c, R = x[i, 0], x[i, 1], x[i, 2], radius[i]
        Z = w2c[2, 0] * a + w2c[2, 1] * b + w2c[2, 2] * c + w2c[2, 3]
        if not (Z - R >= lens[4] and Z < 1e30):
            continue
        X = w2c[0, 0] * a + w2c[0, 1] * b + w2c[0, 2] * c + w2c[0, 3]
        Y = w2c[1, 0] * a + w2c[1, 1] * b + w2c[1, 2] * c + w2c[1, 3]
        x0, x1, y0, y1 = _extent(X, Y, Z, R, lens, height, width)
        # a ball of less than a pixel gives that pixel its volume
        side, power = Z * wide, X * X + Y * Y + Z * Z - R * R
        if R < side:
            x0 = x1 = min(max(int(lens[0] * X / Z + lens[2]), 0), width - 1)
            y0 = y1 = min(max(int(lens[1] * Y / Z + lens[3]), 0), height - 1)
        for j in range(y0, y1 + 1):
            v = (j + 0.5 - lens[3]) * high
            for k in range(x0, x1 + 1):
                if Z > back_depth[j, k]:
                    continue
                u = (k + 0.5 - lens[2]) * wide
                if R < side:
                    length = 4.0 / 3.0 * np.pi * R**3 / (side * side)
                else:
                    square, along = u * u + v * v + 1.0, u * X + v * Y + Z
                    inner = along * along / square - power
                    if inner <= 0.0:
                        continue
                    length = 2.0 * np.sqrt(inner)
                sums[j, k, 0] += length
                for m in range(3):
                    sums[j, k, 1 + m] += length * color[i, m]
                sums[j, k, 4] += length * extinction[i]


@njit_cached(nogil=True, error_model="numpy")
def _box_average(sums, depth, out):
    """Average 3 x 3 pixels with liquid whose background depths [m] belong to one object."""
    height, width = depth.shape
    for j in range(height):
        for k in range(width):
            if sums[j, k, 0] == 0.0:
                continue
            total = np.float32(0)
            for a in range(max(j - 1, 0), min(j + 2, height)):
                for b in range(max(k - 1, 0), min(k + 2, width)):
                    if sums[a, b, 0] > 0.0 and abs(depth[a, b] / depth[j, k] - 1.0) < STEP:
                        total += np.float32(1)
                        for m in range(5):
                            out[j, k, m] += sums[a, b, m]
            for m in range(5):
                out[j, k, m] = out[j, k, m] / total if total > 0 else sums[j, k, m]


@njit_cached(nogil=True, error_model="numpy")
def _upsample(sums, factor, out):
    """Interpolate the sums of pixels `factor` times as large linearly."""
    height, width = out.shape[:2]
    h, w = sums.shape[:2]
    for j in range(height):
        v = min(max((j + 0.5) / factor - 0.5, 0.0), h - 1.0)
        j0 = min(int(v), max(h - 2, 0))
        j1, fj = min(j0 + 1, h - 1), np.float32(v - j0)
        for k in range(width):
            u = min(max((k + 0.5) / factor - 0.5, 0.0), w - 1.0)
            k0 = min(int(u), max(w - 2, 0))
            k1, fk = min(k0 + 1, w - 1), np.float32(u - k0)
            for m in range(5):
                upper = sums[j0, k0, m] + fk * (sums[j0, k1, m] - sums[j0, k0, m])
                lower = sums[j1, k0, m] + fk * (sums[j1, k1, m] - sums[j1, k0, m])
                out[j, k, m] = upper + fj * (lower - upper)


@njit_cached(nogil=True, error_model="numpy")
def _upsample_inverse_depth(inv_depth, factor, limit, out):
    """Interpolate the inverse depths of pixels `factor` times as large within one object."""
    h, w = inv_depth.shape
    for j in range(out.shape[0]):
        v = (j + 0.5) / factor - 0.5
        j0 = int(np.floor(v))
        for k in range(out.shape[1]):
            u = (k + 0.5) / factor - 0.5
            k0 = int(np.floor(u))
            best_weight, best, covered = 0.0, 0.0, 0.0
            total, weighted = 0.0, 0.0
            for pass_index in range(2):  # pass 0 finds the object that covers most of the pixel
                for a in range(2):
                    for b in range(2):
                        weight = abs(1.0 - a - (v - j0)) * abs(1.0 - b - (u - k0))
                        value = inv_depth[min(max(j0 + a, 0), h - 1), min(max(k0 + b, 0), w - 1)]
                        if value == 0.0:
                            continue
                        if pass_index == 0:
                            covered += weight
                            if weight > best_weight:
                                best_weight, best = weight, value
                        elif abs(value - best) <= limit * best * value:
                            total += weight
                            weighted += weight * value
                if covered < 0.5:
                    break
            if total > 0.0:
                out[j, k] = weighted / total


@njit_cached(nogil=True, error_model="numpy", fastmath={"contract", "nsz", "nnan", "ninf"})
def _add_taps(inv_depth, first, step, reach, limit, lanes):
    """Add filter taps on both sides of LANE pixels, from `first` on and `step` apart.

    lanes: (8 LANE,) weighted sum, total weight, weight, its ratio to the next one and the change of
    that ratio, bounds of the inverse depths of the same object, and the clamp for nearer ones.
    """
    if first - reach * step < 0:
        return
    for s in range(1, reach + 1):
        left, right = first - s * step, first + s * step
        if left < 0 or right < 0:  # excludes negative indices for the compiler
            return
        for n in range(LANE):
            weight = lanes[2 * LANE + n] * lanes[3 * LANE + n]
            lanes[2 * LANE + n] = weight
            lanes[3 * LANE + n] *= lanes[4 * LANE + n]
            left_value, right_value = inv_depth[left + n], inv_depth[right + n]
            below = left_value if left_value < right_value else right_value
            above = right_value if left_value < right_value else left_value
            low, high, more = lanes[5 * LANE + n], lanes[6 * LANE + n], lanes[7 * LANE + n]
            weight = weight if below >= low else _ZERO
            left_value = more if left_value > high else left_value
            right_value = more if right_value > high else right_value
            lanes[n] += weight * (left_value + right_value)
            lanes[LANE + n] += weight + weight
            # the object continues beside its own pixels: its depth range follows them outwards
            follows = (below >= low) & (above <= high)
            lower = below - below * below * limit
            upper = above + above * above * limit
            lanes[5 * LANE + n] = lower if follows & (lower < low) else low
            lanes[6 * LANE + n] = upper if follows & (upper > high) else high


@njit_cached(nogil=True, error_model="numpy")
def _narrow_range_filter(inv_depth, step, margin, height, width, blur, limit, beyond):
    """Apply the narrow-range filter to inverse depths along rows (step 1) or columns.

    Inverse depth of a plane is linear in pixels, so planes stay as they are. inv_depth: (pixels,)
    rows with margins of zeros. step: 1, or the length of a row. blur: standard deviation at a depth
    of 1 m [pixels]. limit: depth difference between objects [m]. beyond: clamp of nearer depths
    [m].
    """
    row = width + 2 * margin + LANE
    out, lanes = np.zeros_like(inv_depth), np.empty(8 * LANE, np.float32)
    for j in range(margin, margin + height):
        for k in range(margin, margin + width, LANE):
            first, reach = j * row + k, 0
            for n in range(LANE):
                value = inv_depth[first + n]
                if not value > 0.0:
                    lanes[n::LANE] = 0.0
                    continue
                z = 1.0 / value
                sd = max(blur / z, 0.1)
                reach = max(reach, min(margin, int(np.ceil(2.0 * sd))))
                ratio = np.exp(-0.5 / (sd * sd))
                lanes[n], lanes[LANE + n], lanes[2 * LANE + n] = value, 1.0, 1.0
                lanes[3 * LANE + n], lanes[4 * LANE + n] = ratio, ratio * ratio
                lanes[5 * LANE + n], lanes[6 * LANE + n] = (
                    1.0 / (z + limit),
                    1.0 / max(z - limit, 1e-3 * z),
                )
                lanes[7 * LANE + n] = 1.0 / max(z - beyond, 1e-3 * z)
            if reach == 0:
                continue
            _add_taps(inv_depth, first, step, reach, limit, lanes)
            for n in range(LANE):
                if inv_depth[first + n] > 0.0:
                    out[first + n] = lanes[n] / lanes[LANE + n]
    return out
