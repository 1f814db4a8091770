"""Display values and linear light: sRGB and a tone curve that preserves base colors.

References:
    Khronos Group. Khronos PBR Neutral tone mapper. 2024.
"""

import numpy as np

from vgmpi.runtime.compile_cache import njit_cached

from .compile_options import RAY

START = 0.8 - 0.04  # [-] value of the brightest channel above which it is compressed
DESATURATION = 0.15
ENTRIES = 32768  # [-] entries of the table of sRGB values, linear in between to 1e-6
_TABLE = 1.055 * (np.arange(ENTRIES + 2) / ENTRIES) ** (1 / 2.4) - 0.055


def to_linear(display: np.ndarray) -> np.ndarray:
    """Return the linear light of sRGB display values 0..1."""
    c = np.clip(display, 0.0, 1.0)
    return np.where(c < 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def scene_linear(display: np.ndarray, tone: bool) -> np.ndarray:
    """Return the linear light whose display values are given: the inverse of `show`.

    Saturated bright colors need light below 0 in their smallest channel, as the curve desaturates.
    """
    c = to_linear(display)
    if not tone:
        return c
    peak = c.max(axis=-1, keepdims=True)
    d = 1.0 - START
    bright = np.minimum(peak, 0.995)
    before = d * d / (1.0 - bright) - d + START
    g = 1.0 - 1.0 / (DESATURATION * (before - bright) + 1.0)
    colored = (c - g * bright) / np.maximum(1.0 - g, 1e-6) * (before / np.maximum(bright, 1e-6))
    c = np.where(peak > START, colored, c)
    minimum = c.min(axis=-1, keepdims=True)
    # x - offset of the smallest channel is x below 0, 6.25 x^2 below 0.08, x - 0.04 above
    offset = np.where(minimum < 0.04, np.sqrt(np.maximum(minimum, 0.0) / 6.25) - minimum, 0.04)
    return c + np.where(minimum < 0.0, 0.0, offset)


@njit_cached(**RAY)
def to_display(red, green, blue, tone):
    """Return the display values of linear light.

    Args:
        red, green, blue: Linear light.
        tone: Whether the tone curve is applied.
    """
    if tone:
        minimum = min(red, min(green, blue))
        offset = 0.0
        if minimum > 0.0:
            offset = minimum - 6.25 * minimum * minimum if minimum < 0.08 else 0.04
        red, green, blue = red - offset, green - offset, blue - offset
        peak = max(red, max(green, blue))
        if peak > START:
            d = 1.0 - START
            new = 1.0 - d * d / (peak + d - START)
            scale = new / peak
            g = 1.0 - 1.0 / (DESATURATION * (peak - new) + 1.0)
            red = red * scale + g * (new - red * scale)
            green = green * scale + g * (new - green * scale)
            blue = blue * scale + g * (new - blue * scale)
    return _encoded(red), _encoded(green), _encoded(blue)


@njit_cached(**RAY)
def _encoded(c):
    """Return the sRGB value of linear light."""
    c = min(max(c, 0.0), 1.0)
    if c < 0.0031308:
        return 12.92 * c
    position = c * ENTRIES
    k = int(position)
    return _TABLE[k] + (position - k) * (_TABLE[k + 1] - _TABLE[k])


@njit_cached(nogil=True, error_model="numpy")
def show(light, tone, out):
    """Write the display values of linear light (height, width, 3) to out of that shape."""
    for j in range(light.shape[0]):
        for k in range(light.shape[1]):
            out[j, k, 0], out[j, k, 1], out[j, k, 2] = to_display(
                light[j, k, 0], light[j, k, 1], light[j, k, 2], tone
            )
