"""Doubts about the values of a file: they may not mean what its format says.

Some programs write sizes and opacities where the format has logarithms and logits, or coordinates
that single precision cannot hold. No test can be certain, so values are taken as the format says.
"""

from dataclasses import replace

import numpy as np

from vgmpi.gaussians.cloud import GaussianCloud

_SAMPLE = 100_000  # [Gaussians] that are looked at, evenly over the file
_MIN_COUNT = 16  # [Gaussians] that a statement about their distribution needs
_COVER = 5.0  # [-] median size over median spacing; captures have about 1
_FEW_VALUES = 16  # [-] different opacities that a program may have chosen
_DIGITS = (1, 2, 3)  # [-] decimals of an opacity that a person chose


def add_doubts(
    cloud: GaussianCloud, has_log_scales: bool, has_logits: bool, has_float_rgb: bool = False
) -> GaussianCloud:
    """Add doubts about the values of a file to the record of its cloud.

    Args:
        cloud: Cloud as read, with a record.
        has_log_scales: Whether the file stores logarithms of sizes.
        has_logits: Whether the file stores logits of opacities.
        has_float_rgb: Whether the file stores red, green and blue as floating-point numbers.
    """
    sample = slice(None, None, -(-len(cloud) // _SAMPLE))
    doubts: list[str] = []
    if has_log_scales and _has_linear_scales(cloud, cloud.scale[sample]):
        doubts.append(
            "scale_0..2 look like lengths, not logarithms: none is negative, and as logarithms they"
            " make most Gaussians much larger than the distance to the next one"
        )
    if has_logits and _has_linear_opacities(cloud.opacity[sample]):
        doubts.append("opacity looks like opacities, not logits: all values lie in 0..1")
    if has_float_rgb and (cloud.sh[sample, 0] > 3.6).mean() > 0.5:  # 3.6: twice full color
        doubts.append("red, green, blue are floating-point numbers, but most are above 1")
    coarse = _coarse_axes(cloud.x[sample], cloud.scale[sample])
    if coarse:
        doubts.append(
            f"{', '.join(coarse)} are too coarse for the sizes of the Gaussians: single precision"
            " so far from the origin rounds them; subtract an offset before export"
        )
    assert cloud.record is not None
    return replace(cloud, record=replace(cloud.record, doubts=(*cloud.record.doubts, *doubts)))


def _has_linear_scales(cloud: GaussianCloud, scale: np.ndarray) -> bool:
    """Return whether sizes (n, 3) [file units] are exponentials of what were sizes already.

    As logarithms, the stored numbers must not fit the spacing of the Gaussians, and as sizes they
    must fit it better.
    """
    if len(cloud) < _MIN_COUNT or not (scale >= 1.0).all():
        return False
    from scipy.spatial import cKDTree  # only doubtful clouds need it

    some = cloud.x[:: -(-len(cloud) // 1000)]
    spacing = float(np.median(cKDTree(cloud.x).query(some, 2)[0][:, 1]))
    stored = float(np.median(np.log(scale)))
    is_nearer = stored * np.exp(stored) > spacing**2  # in ratio to the spacing
    return bool(is_nearer and np.exp(stored) > _COVER * spacing > 0)


def _has_linear_opacities(opacity: np.ndarray) -> bool:
    """Return whether opacities (n,) are those of numbers that were opacities already.

    Captures have opacities on both sides of 0.5, so many different logits do not all lie in 0..1.
    A few different ones were chosen, by a program or a person: as round opacities.
    """
    inner = opacity[(opacity > 0) & (opacity < 1)]
    stored = np.log(inner / (1 - inner))
    tolerance = 1e-6  # rounding of float32
    if not len(inner) == len(opacity) >= 1:
        return False
    if stored.min() < -tolerance or stored.max() > 1 + tolerance:
        return False
    values = np.unique(np.round(stored, 5))
    if len(values) > _FEW_VALUES:
        return len(opacity) >= _MIN_COUNT
    of_logits = 1 / (1 + np.exp(-stored))
    return any(
        _is_round(stored, k, tolerance) and not _is_round(of_logits, k, tolerance) for k in _DIGITS
    )


def _is_round(values: np.ndarray, digits: int, tolerance: float) -> bool:
    """Return whether all values have at most as many decimals."""
    return bool((np.abs(values - np.round(values, digits)) <= tolerance).all())


def _coarse_axes(x: np.ndarray, scale: np.ndarray) -> list[str]:
    """Return the axes whose coordinates (n, 3) are single precision and coarser than the sizes."""
    size = float(np.median(scale.max(axis=1)))
    step = np.median(np.spacing(np.abs(x).astype(np.float32)), axis=0)
    is_single = (x == x.astype(np.float32)).all(axis=0)
    return [axis for axis, coarse in zip("xyz", is_single & (step > size)) if coarse]
