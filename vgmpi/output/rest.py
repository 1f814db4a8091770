"""gaussians.h5: the rest state of every particle and how it looks, a row per id, written once."""

import json
from pathlib import Path

import numpy as np

from vgmpi.domain.ranks import Alone
from vgmpi.output import layout, read, store


def write(
    path: str | Path,
    ranks: Alone,
    rows: dict[str, np.ndarray] | None,
    objects: list[dict] | None,
    scenery: dict[str, np.ndarray] | None = None,
    scene: dict | None = None,
    digest: str = "",
    passive: dict[str, np.ndarray] | None = None,
) -> None:
    """Write the file from what rank 0 has; collective, the arguments of the others are ignored.

    rows: the datasets of layout.GAUSSIAN, all but layout.OPTIONAL must be there. scenery, passive:
    those of layout.SCENERY and layout.PASSIVE likewise, or None. objects: the list of the objects;
    scene: the scene resolved; both JSON-able. Raises StoreError on all ranks.
    """
    path = Path(path)
    error: Exception | None = None
    if ranks.rank == 0:
        checked = _checked(rows, layout.GAUSSIAN, "")
        if scenery is not None:
            checked |= _checked(scenery, layout.SCENERY, "scenery/")
        if passive is not None:
            checked |= _checked(passive, layout.PASSIVE, "passive/")
        try:
            with store.create(path, Alone()) as f:
                f.attr("", "schema", layout.SCHEMA)
                f.attr("", "digest", digest)
                f.text("objects", json.dumps(objects))
                f.text("scene", json.dumps(scene or {}))
                for name, array in checked.items():
                    f.rows(name, array)
                f.seal()
        except store.StoreError as caught:
            error = caught.__cause__ if isinstance(caught.__cause__, Exception) else caught
    store.agree(ranks, error, path)


def _checked(rows, datasets, prefix):
    """Arrays in the types of the layout, keyed by their names in the file."""
    names = {d.name for d in datasets}
    if set(rows) - names or names - set(layout.OPTIONAL) - set(rows):
        raise ValueError(f"{prefix or 'particles'}: want {sorted(names)}, got {sorted(rows)}")
    found = {}
    for d in datasets:
        if d.name not in rows:
            continue
        array = np.asarray(rows[d.name]).astype(d.dtype, copy=False)
        if not layout.fits(d, array) or len(array) != len(rows["x0"]):
            raise ValueError(f"{prefix}{d.name}: want {d.shape}, got {array.shape}")
        found[prefix + d.name] = array
    return found


def read_slice(path: str | Path, start: int, stop: int) -> dict[str, np.ndarray]:
    """Particles start .. stop - 1: the datasets of layout.GAUSSIAN that are there. Raises
    read.RunError."""
    with read.opened(Path(path)) as f:
        names = [d.name for d in layout.GAUSSIAN if d.name in f]
        return {name: f[name][start:stop] for name in names}


def digest(path: str | Path) -> str:
    """What the file says it was prepared from; "" where there is no such file."""
    try:
        with read.opened(Path(path)) as f:
            return f.attrs["digest"].decode()
    except read.RunError:
        return ""
