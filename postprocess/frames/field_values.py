"""Fields of the frames as colors: one value per particle, a color map, and a color bar."""

import html

import numpy as np

from vgmpi.io import file_layout
from vgmpi.io.run_reader import RunError


def scalars(frame: dict[str, np.ndarray], color: str) -> np.ndarray:
    """Return the values to color by, (n,): a field, the length of a vector, or one component.

    color: "J", "velocity" (its length), "velocity.z", "F.0" ... "F.8", "x.z". Raises RunError.
    """
    name, _, part = color.partition(".")
    if name not in frame:
        raise RunError(f"{color}: this frame has {', '.join(frame)}")
    values = np.asarray(frame[name])
    if values.ndim == 1:
        if part:
            raise RunError(f"{color}: {name} has no components")
        return values
    if not part:
        return np.linalg.norm(values, axis=1)
    names = list("xyz") if values.shape[1] == 3 else [str(i) for i in range(values.shape[1])]
    if part not in names:
        raise RunError(f"{color}: allowed are {name}.{names[0]} .. {name}.{names[-1]}")
    return values[:, names.index(part)]


def title(color: str) -> str:
    """Return the title of the color bar: field and unit."""
    units = {d.name: d.unit for d in file_layout.FRAME}
    unit = units.get(color.partition(".")[0], "1")
    return color if unit == "1" else f"{color} [{unit}]"


# "viridis" of S. van der Walt and N. Smith (2015) at 17 equidistant values; linear between them it
# differs from the original by less than 0.03
VIRIDIS = (
    "440154 48186a 472d7b 424086 3b528b 33638d 2c728e 26828e 21918c"
    " 1fa088 28ae80 3fbc73 5ec962 84d44b addc30 d8e219 fde725"
)
MAX_COMPONENTS = 9  # of a field whose components are offered


def list_fields(frame: dict[str, np.ndarray]) -> list[str]:
    """Return the names that `scalars` accepts for a frame, but the particles' numbers."""
    names = []
    for name, array in frame.items():
        if name in ("id", "poses"):
            continue
        names.append(name)
        components = 1 if array.ndim == 1 else array.shape[1]
        if components == 3:
            names += [f"{name}.{axis}" for axis in "xyz"]
        elif 1 < components <= MAX_COMPONENTS:
            names += [f"{name}.{k}" for k in range(components)]
    return names


def map_colors(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return the colors 0..1 of values, shape (n, 3); gray where a value is no number.

    Args:
        values: Shape (n,).
        low: Value of the first color; smaller ones have it too.
        high: Value of the last color.
    """
    table = np.array([list(bytes.fromhex(word)) for word in VIRIDIS.split()]) / 255
    part = (np.asarray(values, dtype=np.float64) - low) / ((high - low) or 1.0)
    is_number = np.isfinite(part)
    part = np.where(is_number, part, 0.0)
    positions = np.linspace(0, 1, len(table))
    colors = np.stack([np.interp(part, positions, column) for column in table.T], axis=1)
    colors[~is_number] = 0.5
    return colors


def color_bar(color: str, low: float, high: float) -> str:
    """Return the color bar of a field as HTML: its title, the colors, and five values."""
    stops = ", ".join(f"#{word}" for word in VIRIDIS.split())
    ticks = "".join(f"<span>{value:.4g}</span>" for value in np.linspace(low, high, 5))
    return (
        '<div style="font-size:0.8em;padding:0 0.5em">'
        f"<div>{html.escape(title(color))}</div>"
        f'<div style="height:1em;background:linear-gradient(to right, {stops})"></div>'
        f'<div style="display:flex;justify-content:space-between">{ticks}</div></div>'
    )
