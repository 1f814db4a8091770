"""Inpainting of the photograph behind its objects.

Edges of tables, floors and walls continue behind the objects, level or upright. Each gap is
therefore first filled along its rows and along its columns by linear interpolation between its two
ends, and the direction whose ends agree better has the larger weight. Grain, tiles and grass do not
continue so: patches of the photograph fill the gap again, and what resembles the photograph more is
taken. OpenCV's inpainting (Telea 2004) rounds edges off and blurs grain.

Patches come from several scales: each patch that touches the gap gets the most similar patch of the
known picture (PatchMatch), and each pixel of the gap the mean of the pixels that these patches have
there, or at the end the pixel of the best of them.

References:
    Wexler, Shechtman and Irani 2007; Barnes, Shechtman, Finkelstein and Goldman 2009.
"""

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from vgmpi.runtime.jit import device_function, kernel

from .grabcut import MaskError, opencv

RADIUS = 3  # [pixels] half of a patch, without its middle
COARSEST_DEPTH = 3.0  # [pixels] depth of the gap at the coarsest scale
MIN_SIDE = 24  # [pixels] shorter side of the picture at the coarsest scale
ROUNDS = (8, 4, 3)  # rounds at the coarsest scale, at those between, and at the finest
SHARP_ROUNDS = 2  # rounds at the finest scale that end with pixels of one patch, not with means
RIM_WIDTH = 2.0  # [pixels] distance from the rim over which colors are averaged
BLEND_DEPTH = 16.0  # [pixels] depth to which the colors at the rim are carried into the gap
SWEEPS = 3  # sweeps of a search
DEPTH_WEIGHT = 1.3  # [-] a pixel of the gap has this part less weight than one further out
TYPICAL_QUANTILE = 0.75  # [-] patches that are worse than this fraction of all hardly count
MASK_DILATION = 3  # [pixels] masks are widened by this before they are inpainted
END_PIXELS = 4  # [pixels] this many are averaged at each end of a gap
COLOR_NOISE = 4.0  # [0..255] noise makes equal ends differ by about this
RING = 3, 12  # [pixels] distances from a gap between which steps between pixels are usual
WEIGHT_SMOOTHING = 2.0  # [pixels] the weights are smoothed over neighboring rows or columns by this


class Patches(NamedTuple):
    """Patches that touch a gap, and their most similar patches outside of it."""

    middle: np.ndarray  # (n, 2) row and column of their middle
    sources: np.ndarray  # (height, width) bool, middles of patches without a pixel of the gap
    match: np.ndarray  # (height, width, 2) middle of the similar patch, -1: none
    cost: np.ndarray  # (height, width) sum of squared differences


def synthesize(rgb: np.ndarray, gap: np.ndarray) -> np.ndarray:
    """Return a picture with its gap filled by patches from elsewhere, (height, width, 3) uint8.

    Args:
        rgb: Picture, shape (height, width, 3) uint8, with a first estimate in the gap.
        gap: Pixels to fill, (height, width) bool.
    """
    scales = _pyramid(rgb.astype(np.float64), gap)
    random, match = np.random.default_rng(1), None
    finer = scales[-1][0]
    for k in range(len(scales) - 1, -1, -1):
        picture, hole = scales[k][0].copy(), scales[k][1]
        size = picture.shape[1], picture.shape[0]
        if match is not None:
            picture[hole] = opencv().resize(finer, size)[hole]
        patches = _patches(hole, match, random)
        if patches is None:  # the gap leaves no whole patch
            finer = picture
            continue
        coarsest = k == len(scales) - 1
        rounds = ROUNDS[0] if coarsest else ROUNDS[1] if k else ROUNDS[2]
        weight = DEPTH_WEIGHT ** -ndimage.distance_transform_edt(hole)
        for n in range(rounds):
            _search(picture, patches, random, SWEEPS)
            if k == 0 and n >= rounds - SHARP_ROUNDS:
                _take_best(picture.copy(), hole, patches, weight, picture)
            else:
                _average(picture.copy(), hole, patches, weight, picture)
        match, finer = patches.match, picture
    return np.clip(_with_equal_rim(finer, gap) + 0.5, 0, 255).astype(np.uint8)


def _with_equal_rim(picture: np.ndarray, gap: np.ndarray) -> np.ndarray:
    """Return a picture whose filled gap has the mean colors of its surroundings along the rim.

    Args:
        picture: Picture, shape (height, width, 3).
        gap: Pixels that were filled, (height, width) bool.
    """

    def local_mean(weight: np.ndarray, values: np.ndarray, width: float) -> np.ndarray:
        """Return the weighted mean of values around each pixel."""
        total = ndimage.gaussian_filter(weight, width)[..., None]
        mean = ndimage.gaussian_filter(weight[..., None] * values, (width, width, 0))
        return mean / np.maximum(total, 1e-12)

    rim = (gap & ndimage.binary_dilation(~gap)).astype(np.float64)
    outside, inside = (~gap).astype(np.float64), gap.astype(np.float64)
    step = local_mean(outside, picture, RIM_WIDTH) - local_mean(inside, picture, RIM_WIDTH)
    depth = ndimage.distance_transform_edt(gap)
    fading = np.where(gap, np.exp(-((depth / BLEND_DEPTH) ** 2)), 0.0)
    return picture + fading[..., None] * local_mean(rim, step, BLEND_DEPTH / 2)


def patch_distance(rgb: np.ndarray, gap: np.ndarray) -> float:
    """Return the mean difference between a filled gap's patches and the picture's [0..255].

    Args:
        rgb: Picture with the filled gap, shape (height, width, 3) uint8.
        gap: Pixels that were filled, (height, width) bool.
    """
    patches = _patches(gap, None, np.random.default_rng(1))
    if patches is None:
        return 0.0
    _search(rgb.astype(np.float64), patches, np.random.default_rng(2), 2 * SWEEPS)
    row, column = patches.middle.T
    return float(np.sqrt(patches.cost[row, column].mean() / (3 * (2 * RADIUS + 1) ** 2)))


def _pyramid(picture: np.ndarray, gap: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return picture and gap at scales 1, 2, 4 ... until the gap is hardly deeper than a patch."""
    cv2 = opencv()
    scales = [(picture, gap)]
    depth = float(ndimage.distance_transform_edt(gap).max())
    while depth > COARSEST_DEPTH:
        picture, gap = scales[-1]
        size = picture.shape[1] // 2, picture.shape[0] // 2
        if min(size) < MIN_SIDE:
            break
        part = cv2.resize(gap.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        scales.append((cv2.resize(picture, size, interpolation=cv2.INTER_AREA), part > 0))
        depth /= 2
    return scales


def _patches(
    gap: np.ndarray, coarse: np.ndarray | None, random: np.random.Generator
) -> Patches | None:
    """Return the patches of a gap with matches of the coarser scale or at random; None if none.

    Args:
        gap: Pixels to fill, (height, width) bool.
        coarse: Matches at the coarser scale, (rows, columns, 2), or None.
        random: Generator of the other matches.
    """
    height, width = gap.shape
    touching = ndimage.binary_dilation(gap, np.ones((2 * RADIUS + 1,) * 2))
    inner = np.zeros_like(gap)
    inner[RADIUS : height - RADIUS, RADIUS : width - RADIUS] = True
    usable, middle = ~touching & inner, np.argwhere(touching & inner)
    places = np.argwhere(usable)
    if not len(places) or not len(middle):
        return None
    match = np.full((height, width, 2), -1, np.int64)
    chosen = places[random.integers(0, len(places), len(middle))]
    if coarse is not None:
        above = np.minimum(middle // 2, np.array(coarse.shape[:2]) - 1)
        finer = 2 * coarse[above[:, 0], above[:, 1]] + middle % 2
        inside = (coarse[above[:, 0], above[:, 1], 0] >= 0) & (finer < gap.shape).all(axis=1)
        inside[inside] = usable[finer[inside, 0], finer[inside, 1]]
        chosen[inside] = finer[inside]
    match[middle[:, 0], middle[:, 1]] = chosen
    return Patches(middle, usable, match, np.zeros(gap.shape))


@device_function
def _difference(picture, y, x, row, column, limit):
    """Return the sum of squared differences of two patches, or one that is above a limit.

    Args:
        picture: Picture, shape (height, width, 3).
        y, x: Middle of one patch.
        row, column: Middle of the other.
        limit: A sum above it need not be exact.
    """
    total = 0.0
    for i in range(-RADIUS, RADIUS + 1):
        for j in range(-RADIUS, RADIUS + 1):
            for c in range(3):
                d = picture[y + i, x + j, c] - picture[row + i, column + j, c]
                total += d * d
        if total >= limit:
            return total
    return total


@device_function
def _try_match(picture, patches, y, x, row, column):
    """Take a patch as the match of another if it is known and more similar.

    Args:
        picture: Picture, shape (height, width, 3).
        patches: Patches (in/out).
        y, x: Middle of the patch.
        row, column: Middle of the candidate.
    """
    height, width = patches.sources.shape
    if 0 <= row < height and 0 <= column < width and patches.sources[row, column]:
        cost = _difference(picture, y, x, row, column, patches.cost[y, x])
        if cost < patches.cost[y, x]:
            patches.cost[y, x] = cost
            patches.match[y, x, 0], patches.match[y, x, 1] = row, column


@kernel
def _search(picture, patches, random, sweeps):
    """Improve the matches of patches: by those of their neighbors, and at random around them.

    Args:
        picture: Picture, shape (height, width, 3).
        patches: Patches (in/out).
        random: Generator of the random candidates.
        sweeps: Number of sweeps over all patches.
    """
    height, width = patches.sources.shape
    middle, match = patches.middle, patches.match
    for y, x in middle:
        patches.cost[y, x] = _difference(picture, y, x, match[y, x, 0], match[y, x, 1], np.inf)
    for sweep in range(sweeps):
        step = 1 - 2 * (sweep % 2)
        for n in range(len(middle)):
            y, x = middle[n if step == 1 else len(middle) - 1 - n]
            for a in range(2):
                row, column = y - step * (1 - a), x - step * a
                if 0 <= row < height and 0 <= column < width and match[row, column, 0] >= 0:
                    source = match[row, column, 0] + y - row, match[row, column, 1] + x - column
                    _try_match(picture, patches, y, x, source[0], source[1])
            reach = max(height, width)
            while reach >= 1:
                row = match[y, x, 0] + random.integers(-reach, reach + 1)
                column = match[y, x, 1] + random.integers(-reach, reach + 1)
                _try_match(picture, patches, y, x, row, column)
                reach //= 2


@kernel
def _average(picture, gap, patches, weight, result):
    """Fill a gap with the weighted means of the matches' pixels.

    Args:
        picture: Picture, shape (height, width, 3).
        gap: Pixels to fill, (height, width) bool.
        patches: Patches with their matches.
        weight: Weight of each patch, (height, width).
        result: Picture (in/out).
    """
    total = np.zeros(gap.shape)
    costs = np.zeros(len(patches.middle))
    for n in range(len(patches.middle)):
        costs[n] = patches.cost[patches.middle[n, 0], patches.middle[n, 1]]
    typical = np.sort(costs)[int(TYPICAL_QUANTILE * (len(costs) - 1))] + 1e-6
    colors = np.zeros(picture.shape)
    for y, x in patches.middle:
        w = weight[y, x] * np.exp(-patches.cost[y, x] / (2.0 * typical))
        for i in range(-RADIUS, RADIUS + 1):
            for j in range(-RADIUS, RADIUS + 1):
                if gap[y + i, x + j]:
                    total[y + i, x + j] += w
                    for c in range(3):
                        source = picture[patches.match[y, x, 0] + i, patches.match[y, x, 1] + j, c]
                        colors[y + i, x + j, c] += w * source
    for y, x in np.argwhere(gap):
        if total[y, x] > 0.0:
            for c in range(3):
                result[y, x, c] = colors[y, x, c] / total[y, x]


@kernel
def _take_best(picture, gap, patches, weight, result):
    """Fill a gap with the pixels of the best match that covers them, which blurs nothing.

    Args:
        picture: Picture, shape (height, width, 3).
        gap: Pixels to fill, (height, width) bool.
        patches: Patches with their matches.
        weight: Weight of each patch, (height, width).
        result: Picture (in/out).
    """
    best = np.full(gap.shape, np.inf)
    for y, x in patches.middle:
        for i in range(-RADIUS, RADIUS + 1):
            for j in range(-RADIUS, RADIUS + 1):
                if gap[y + i, x + j]:
                    cost = patches.cost[y, x] * (1.0 + 0.15 * (i * i + j * j)) / weight[y, x]
                    if cost < best[y + i, x + j]:
                        best[y + i, x + j] = cost
                        for c in range(3):
                            source = picture[
                                patches.match[y, x, 0] + i, patches.match[y, x, 1] + j, c
                            ]
                            result[y + i, x + j, c] = source


def inpaint_background(rgb: np.ndarray, masks: list[np.ndarray]) -> np.ndarray:
    """Return the photograph with its objects inpainted, (height, width, 3) uint8.

    Args:
        rgb: Photograph, shape (height, width, 3) uint8.
        masks: Objects to remove, each (height, width) bool.

    Raises:
        MaskError: The objects fill the whole picture.
    """
    gap, lines = _fill_along_lines(rgb, masks)
    return min((lines, synthesize(lines, gap)), key=lambda filled: visibility(filled, gap))


def interpolate_background(rgb: np.ndarray, masks: list[np.ndarray]) -> np.ndarray:
    """Return the photograph with its objects filled by interpolation alone, as inpaint_background.

    Raises:
        MaskError: The objects fill the whole picture.
    """
    return _fill_along_lines(rgb, masks)[1]


def visibility(rgb: np.ndarray, gap: np.ndarray) -> float:
    """Return how visible a filled gap is: by its texture and its seam [0..255].

    Args:
        rgb: Picture with the filled gap, shape (height, width, 3) uint8.
        gap: Pixels that were filled, (height, width) bool.
    """
    return patch_distance(rgb, gap) * max(seam_contrast(rgb, gap), 1.0)


def seam_contrast(rgb: np.ndarray, gap: np.ndarray) -> float:
    """Return the mean step across the rim of a gap over that between pixels around it.

    Args:
        rgb: Picture with the filled gap, shape (height, width, 3) uint8.
        gap: Pixels that were filled, (height, width) bool.
    """
    inner = ndimage.binary_dilation(gap, iterations=RING[0])
    ring = ndimage.binary_dilation(gap, iterations=RING[1]) & ~inner
    across, beyond = [], []
    for picture, mask, area in ((rgb, gap, ring), (rgb.swapaxes(0, 1), gap.T, ring.T)):
        step = np.abs(np.diff(picture.astype(np.float64), axis=0)).mean(-1)
        across.append(step[mask[1:] != mask[:-1]])
        beyond.append(step[area[1:] & area[:-1]])
    seam, usual = np.concatenate(across), np.concatenate(beyond)
    return float(seam.mean() / max(usual.mean(), 1e-9)) if len(seam) and len(usual) else 1.0


def _fill_along_lines(rgb: np.ndarray, masks: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return the gap that objects leave, and the photograph with the gap filled by interpolation.

    Args:
        rgb: Photograph, shape (height, width, 3) uint8.
        masks: Objects to remove, each (height, width) bool.

    Raises:
        MaskError: The objects fill the whole picture.
    """
    gap = ndimage.binary_dilation(np.logical_or.reduce(masks), iterations=MASK_DILATION)
    if gap.all():
        raise MaskError("the objects fill the whole picture: no background is left")
    level, level_weight = _fill_rows(rgb, gap)
    upright, upright_weight = _fill_rows(rgb.swapaxes(0, 1), gap.T)
    upright, upright_weight = upright.swapaxes(0, 1), upright_weight.T
    weight = ndimage.gaussian_filter(level_weight, (WEIGHT_SMOOTHING, 0))[..., None]
    other = ndimage.gaussian_filter(upright_weight, (0, WEIGHT_SMOOTHING))[..., None]
    mean = (weight * level + other * upright) / np.maximum(weight + other, 1e-30)
    filled = np.where(gap[..., None], np.clip(mean + 0.5, 0, 255), rgb).astype(np.uint8)
    return gap, filled


def _fill_rows(rgb: np.ndarray, gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fill the gaps of a picture (height, width, 3) along its rows.

    Returns:
        The filled picture, and the weight of each filled pixel, shape (height, width), 0 where
        nothing could be interpolated.
    """
    filled = rgb.astype(np.float64)
    trust = np.zeros(gap.shape)
    edges = np.diff(np.pad(gap, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    starts, stops = np.argwhere(edges == 1), np.argwhere(edges == -1)
    for (row, first), (_, last) in zip(starts, stops):
        line = rgb[row].astype(np.float64)
        ends = [line[max(0, first - END_PIXELS) : first], line[last : last + END_PIXELS]]
        ends = [end for end in ends if len(end)]
        if not ends:
            continue
        left, right = ends[0].mean(axis=0), ends[-1].mean(axis=0)
        fraction = ((np.arange(first, last) - first + 0.5) / (last - first))[:, None]
        filled[row, first:last] = left * (1 - fraction) + right * fraction
        difference = float(np.abs(left - right).mean()) + COLOR_NOISE
        alone = 4.0 if len(ends) == 1 else 1.0  # a single end constrains the gap less
        trust[row, first:last] = 1 / (alone * (last - first) * difference) ** 2
    return filled, trust
