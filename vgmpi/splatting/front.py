"""The front of a liquid on a picture: how far it is, how thick, and of what colour, per pixel.

Every particle is a ball. The nearest balls make the front; a narrow-range filter (N. Truong, C.
Yuksel, "A narrow-range filter for screen-space fluid rendering", 2018) smooths it: depths that are
farther by more than a threshold belong to something else and count as little as their mirror image
across the pixel, so that edges are not bent; nearer ones count as slightly nearer only. What lies
behind is told by sums over all balls before it: the length of the way through them, its colour.
"""

import numpy as np

from vgmpi.caching import cached
from vgmpi.splatting.camera import Camera

BALL = 0.9  # spacings: the radius of balls, whose front has no holes where particles stand in order
ABOVE = 0.3  # spacings that their front is farther out than the liquid's surface, on average
SMOOTH = 1.2  # spacings: the filter's standard deviation along the surface
RANGE = 5.0  # spacings: by more than this, a depth belongs to something else
NEARER = 1.0  # spacings: as how much nearer what is nearer than that counts
ROUNDS = 2
STEP = 0.02  # of its depth: by more, two pixels see different things behind the liquid
LANE = 16  # pixels that are filtered together
_ZERO, _ONE = np.float32(0), np.float32(1)
SMALL = 3.0  # pixels: radius of a ball where the front is looked for
EVEN = 8  # means of 3 x 3 such pixels
COVERED = 1.25  # pixels: radius of a ball where its way through the liquid is looked for
MOST = 24  # pixels of the filter to each side
RADIUS = (3 / (4 * np.pi)) ** (1 / 3)  # spacings: of a ball as large as a particle
FULL = 4  # particles in a cell of two spacings of which one knows that it is not at the surface


def inside(x: np.ndarray, spacing: float) -> np.ndarray:
    """Which particles x (n, 3) [m] have so many around them that they are not at the surface."""
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


def crowd(x: np.ndarray, spacing: float) -> np.ndarray:
    """How many particles x (n, 3) [m] there are within the 27 cells of a spacing and a half around
    each, itself too, of as many as there would be in the middle of a liquid."""
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


def surface(x: np.ndarray, radius: np.ndarray, spacing: float, camera: Camera) -> np.ndarray:
    """Depth, float32 (height, width) [m] along the camera's axis, of the front of balls at x (n, 3)
    [m], smoothed; infinite where there is none. radius: (n,) [m]; spacing: of neighbours [m]."""
    w2c, lens = _view(camera)
    fold = _fold(x, radius, w2c, lens, 2, SMALL)
    coarse = lens / np.array([fold, fold, fold, fold, 1.0])
    height, width = -(-camera.height // fold), -(-camera.width // fold)
    depth = np.full((height, width), np.inf, dtype=np.float32)
    outer = ~inside(x, spacing)
    _balls(x[outer], radius[outer], w2c, coarse, depth)
    margin = MOST
    row = width + 2 * margin + LANE
    near = np.zeros((height + 2 * margin, row), dtype=np.float32)
    near[margin : margin + height, margin : margin + width] = 1 / depth
    blur, limit = SMOOTH * spacing / np.sqrt(ROUNDS), np.float32(RANGE * spacing)
    for _ in range(ROUNDS):
        for step, focal in ((1, coarse[0]), (row, coarse[1])):
            beyond = NEARER * spacing
            sizes = step, margin, height, width, blur * focal, limit, beyond
            near = _narrow(near.ravel(), *sizes).reshape(near.shape)
    found = np.ascontiguousarray(near[margin : margin + height, margin : margin + width])
    if fold > 1:
        full = np.zeros((camera.height, camera.width), dtype=np.float32)
        _between(found, fold, limit, full)
        found = full
    with np.errstate(divide="ignore"):
        return 1 / found


def _fold(x, radius, w2c, lens, most: int, small: float) -> int:
    """How many pixels across may be one, at most, so that a ball's radius is `small` of them."""
    if not len(x):
        return 1
    depth = max(float(np.median(x @ w2c[2, :3] + w2c[2, 3])), lens[4])
    return int(np.clip(np.median(radius) * lens[0] / depth / small, 1, most))


def through(
    x: np.ndarray,
    radius: np.ndarray,
    color: np.ndarray,
    opacity: np.ndarray,
    camera: Camera,
    behind: np.ndarray,
) -> np.ndarray:
    """What balls at x (n, 3) [m] before `behind` (height, width) [m] do to light, float32 (height,
    width, 5): the way through them [m]; the same times red, green and blue; and the exponent by
    which they take light from behind as (opaque) Gaussians would.

    radius: (n,) [m]; color: (n, 3); opacity: (n,). Gaussians of a standard deviation r that stand
    as densely as balls of radius r weaken light by 3 opacity / 2 r per m.
    """
    w2c, lens = _view(camera)
    # all this is smooth: in larger pixels, of which a ball covers some
    fold = _fold(x, radius, w2c, lens, 8, COVERED)
    coarse = lens / np.array([fold, fold, fold, fold, 1.0])
    behind = np.ascontiguousarray(behind[fold // 2 :: fold, fold // 2 :: fold])
    sums = np.zeros((*behind.shape, 5), dtype=np.float32)
    _ways(x, radius, color, 1.5 * opacity / radius, w2c, coarse, behind, sums)
    # balls are round and stand in rows: a pixel's mean with its neighbours is the liquid's
    for _ in range(EVEN):
        passed = np.zeros_like(sums)
        _even(sums, behind, passed)
        sums = passed
    out = np.empty((camera.height, camera.width, 5), dtype=np.float32)
    _finer(sums, fold, out)
    return out


def _view(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """World to camera (4, 4), and fx, fy, cx, cy, near."""
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.near], dtype=np.float64)
    return np.ascontiguousarray(camera.world_to_camera, dtype=np.float64), lens


@cached(nogil=True, error_model="numpy", inline="always")
def _extent(X, Y, Z, R, lens, height, width):
    """First and last column and row that a ball may cover."""
    near = max(Z - R, lens[4])
    wide, far = R / near, 1.0 / Z
    rx, ry = lens[0] * wide, lens[1] * wide
    px, py = lens[0] * X * far + lens[2], lens[1] * Y * far + lens[3]
    x0, x1 = max(0, int(np.floor(px - rx - 0.5))), min(width - 1, int(np.ceil(px + rx - 0.5)))
    y0, y1 = max(0, int(np.floor(py - ry - 0.5))), min(height - 1, int(np.ceil(py + ry - 0.5)))
    return x0, x1, y0, y1


@cached(nogil=True, error_model="numpy")
def _balls(x, radius, w2c, lens, depth):
    """Depth (height, width) of the nearest ball."""
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
        rest = X * X + Y * Y + Z * Z - R * R
        for j in range(y0, y1 + 1):
            v = (j + 0.5 - lens[3]) * high
            for k in range(x0, x1 + 1):
                u = (k + 0.5 - lens[2]) * wide
                square, along = u * u + v * v + 1.0, u * X + v * Y + Z
                root = along * along - square * rest
                if root > 0.0:
                    z = np.float32((along - np.sqrt(root)) / square)
                    if z < depth[j, k]:
                        depth[j, k] = z


@cached(nogil=True, error_model="numpy")
def _ways(x, radius, color, thin, w2c, lens, behind, sums):
    """Add to sums (height, width, 5) the ways through balls in front of `behind`."""
    height, width = behind.shape
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
        side, whole = Z * wide, X * X + Y * Y + Z * Z - R * R
        if R < side:
            x0 = x1 = min(max(int(lens[0] * X / Z + lens[2]), 0), width - 1)
            y0 = y1 = min(max(int(lens[1] * Y / Z + lens[3]), 0), height - 1)
        for j in range(y0, y1 + 1):
            v = (j + 0.5 - lens[3]) * high
            for k in range(x0, x1 + 1):
                if Z > behind[j, k]:
                    continue
                u = (k + 0.5 - lens[2]) * wide
                if R < side:
                    way = 4.0 / 3.0 * np.pi * R**3 / (side * side)
                else:
                    square, along = u * u + v * v + 1.0, u * X + v * Y + Z
                    inner = along * along / square - whole
                    if inner <= 0.0:
                        continue
                    way = 2.0 * np.sqrt(inner)
                sums[j, k, 0] += way
                for m in range(3):
                    sums[j, k, 1 + m] += way * color[i, m]
                sums[j, k, 4] += way * thin[i]


@cached(nogil=True, error_model="numpy")
def _even(sums, behind, out):
    """Means of 3 x 3 pixels, of those before whose `behind` [m] is no other thing's."""
    height, width = behind.shape
    for j in range(height):
        for k in range(width):
            if sums[j, k, 0] == 0.0:
                continue
            total = np.float32(0)
            for a in range(max(j - 1, 0), min(j + 2, height)):
                for b in range(max(k - 1, 0), min(k + 2, width)):
                    if sums[a, b, 0] > 0.0 and abs(behind[a, b] / behind[j, k] - 1.0) < STEP:
                        total += np.float32(1)
                        for m in range(5):
                            out[j, k, m] += sums[a, b, m]
            for m in range(5):
                out[j, k, m] = out[j, k, m] / total if total > 0 else sums[j, k, m]


@cached(nogil=True, error_model="numpy")
def _finer(sums, fold, out):
    """Sums of pixels `fold` times as large, linear in between."""
    height, width = out.shape[:2]
    h, w = sums.shape[:2]
    for j in range(height):
        v = min(max((j + 0.5) / fold - 0.5, 0.0), h - 1.0)
        j0 = min(int(v), max(h - 2, 0))
        j1, fj = min(j0 + 1, h - 1), np.float32(v - j0)
        for k in range(width):
            u = min(max((k + 0.5) / fold - 0.5, 0.0), w - 1.0)
            k0 = min(int(u), max(w - 2, 0))
            k1, fk = min(k0 + 1, w - 1), np.float32(u - k0)
            for m in range(5):
                near = sums[j0, k0, m] + fk * (sums[j0, k1, m] - sums[j0, k0, m])
                far = sums[j1, k0, m] + fk * (sums[j1, k1, m] - sums[j1, k0, m])
                out[j, k, m] = near + fj * (far - near)


@cached(nogil=True, error_model="numpy")
def _between(near, fold, limit, out):
    """1 / depth of pixels `fold` times as large, linear in between where they are of one thing."""
    h, w = near.shape
    for j in range(out.shape[0]):
        v = (j + 0.5) / fold - 0.5
        j0 = int(np.floor(v))
        for k in range(out.shape[1]):
            u = (k + 0.5) / fold - 0.5
            k0 = int(np.floor(u))
            most, best, there = 0.0, 0.0, 0.0
            total, sum = 0.0, 0.0
            for turn in range(2):  # the first finds the thing that has most of the pixel
                for a in range(2):
                    for b in range(2):
                        weight = abs(1.0 - a - (v - j0)) * abs(1.0 - b - (u - k0))
                        here = near[min(max(j0 + a, 0), h - 1), min(max(k0 + b, 0), w - 1)]
                        if here == 0.0:
                            continue
                        if turn == 0:
                            there += weight
                            if weight > most:
                                most, best = weight, here
                        elif abs(here - best) <= limit * best * here:
                            total += weight
                            sum += weight * here
                if there < 0.5:
                    break
            if total > 0.0:
                out[j, k] = sum / total


@cached(nogil=True, error_model="numpy", fastmath={"contract", "nsz", "nnan", "ninf"})
def _taps(near, first, step, reach, limit, lanes):
    """Add to LANE pixels of near (pixels,), from `first` on, those to both sides of them, `step`
    after `step`. lanes: (8 LANE,): sum, total, weight, its ratio to the next and this one's, the
    least and the most that is of the same thing, and what counts for more."""
    if first - reach * step < 0:
        return
    for s in range(1, reach + 1):
        left, right = first - s * step, first + s * step
        if left < 0 or right < 0:  # tells the compiler that no index wraps around
            return
        for n in range(LANE):
            weight = lanes[2 * LANE + n] * lanes[3 * LANE + n]
            lanes[2 * LANE + n] = weight
            lanes[3 * LANE + n] *= lanes[4 * LANE + n]
            one, two = near[left + n], near[right + n]
            below = one if one < two else two
            above = two if one < two else one
            low, high, more = lanes[5 * LANE + n], lanes[6 * LANE + n], lanes[7 * LANE + n]
            weight = weight if below >= low else _ZERO
            one = more if one > high else one
            two = more if two > high else two
            lanes[n] += weight * (one + two)
            lanes[LANE + n] += weight + weight
            # what is beside the same thing is of it, too, and so is what is not far from that
            follows = (below >= low) & (above <= high)
            lower = below - below * below * limit
            upper = above + above * above * limit
            lanes[5 * LANE + n] = lower if follows & (lower < low) else low
            lanes[6 * LANE + n] = upper if follows & (upper > high) else high


@cached(nogil=True, error_model="numpy")
def _narrow(near, step, margin, height, width, blur, limit, beyond):
    """The narrow-range filter of 1 / depth near (pixels,), rows with margins of zeros, 0 where
    nothing is, along rows (step 1) or columns (step: the length of a row). Of planes 1 / depth is
    linear in pixels: they stay. blur: standard deviation at a depth of 1 m [pixels]; limit, beyond:
    by more than that [m] a depth is of something else; how much nearer [m] what is nearer counts.
    """
    row = width + 2 * margin + LANE
    out, lanes = np.zeros_like(near), np.empty(8 * LANE, np.float32)
    for j in range(margin, margin + height):
        for k in range(margin, margin + width, LANE):
            first, reach = j * row + k, 0
            for n in range(LANE):
                here = near[first + n]
                if not here > 0.0:
                    lanes[n::LANE] = 0.0
                    continue
                z = 1.0 / here
                sd = max(blur / z, 0.1)
                reach = max(reach, min(margin, int(np.ceil(2.0 * sd))))
                ratio = np.exp(-0.5 / (sd * sd))
                lanes[n], lanes[LANE + n], lanes[2 * LANE + n] = here, 1.0, 1.0
                lanes[3 * LANE + n], lanes[4 * LANE + n] = ratio, ratio * ratio
                lanes[5 * LANE + n], lanes[6 * LANE + n] = (
                    1.0 / (z + limit),
                    1.0 / max(z - limit, 1e-3 * z),
                )
                lanes[7 * LANE + n] = 1.0 / max(z - beyond, 1e-3 * z)
            if reach == 0:
                continue
            _taps(near, first, step, reach, limit, lanes)
            for n in range(LANE):
                if near[first + n] > 0.0:
                    out[first + n] = lanes[n] / lanes[LANE + n]
    return out
