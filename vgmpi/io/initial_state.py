"""Initial state file gaussians.h5: reference state and look of every particle, a row per id."""

import json
from pathlib import Path

import numpy as np

from vgmpi.parallel.communicator import SerialCommunicator

from . import file_layout, hdf5_writer, run_reader


def write(
    path: str | Path,
    ranks: SerialCommunicator,
    rows: dict[str, np.ndarray] | None,
    objects: list[dict] | None,
    scenery: dict[str, np.ndarray] | None = None,
    scene: dict | None = None,
    digest: str = "",
    passive: dict[str, np.ndarray] | None = None,
) -> None:
    """Write the file from the data of rank 0. Collective; other ranks' arguments are ignored.

    Args:
        path: File to write.
        ranks: Communicator.
        rows: Datasets of file_layout.GAUSSIAN; all but those in file_layout.OPTIONAL are required.
        objects: List of the objects, JSON-able.
        scenery: Datasets of file_layout.SCENERY likewise, or None.
        scene: Resolved scene, JSON-able.
        digest: Text that identifies the preparation.
        passive: Datasets of file_layout.PASSIVE likewise, or None.

    Raises:
        StoreError: Writing failed, on all ranks.
    """
    path = Path(path)
    error: Exception | None = None
    if ranks.rank == 0:
        checked = _checked(rows, file_layout.GAUSSIAN, "")
        if scenery is not None:
            checked |= _checked(scenery, file_layout.SCENERY, "scenery/")
        if passive is not None:
            checked |= _checked(passive, file_layout.PASSIVE, "passive/")
        try:
            with hdf5_writer.create(path, SerialCommunicator()) as f:
                f.attr("", "schema", file_layout.SCHEMA)
                f.attr("", "digest", digest)
                f.text("objects", json.dumps(objects))
                f.text("scene", json.dumps(scene or {}))
                for name, array in checked.items():
                    f.rows(name, array)
                f.seal()
        except hdf5_writer.StoreError as caught:
            error = caught.__cause__ if isinstance(caught.__cause__, Exception) else caught
    hdf5_writer.raise_on_all_ranks(ranks, error, path)


def _checked(rows, datasets, prefix):
    """Return arrays in the types of the layout, by their names in the file."""
    names = {d.name for d in datasets}
    if set(rows) - names or names - set(file_layout.OPTIONAL) - set(rows):
        raise ValueError(f"{prefix or 'particles'}: want {sorted(names)}, got {sorted(rows)}")
    result = {}
    for d in datasets:
        if d.name not in rows:
            continue
        array = np.asarray(rows[d.name]).astype(d.dtype, copy=False)
        if not file_layout.fits(d, array) or len(array) != len(rows["x0"]):
            raise ValueError(f"{prefix}{d.name}: want {d.shape}, got {array.shape}")
        result[prefix + d.name] = array
    return result


def read_slice(path: str | Path, start: int, stop: int) -> dict[str, np.ndarray]:
    """Return the datasets of file_layout.GAUSSIAN for some particles. Raises RunError.

    Args:
        path: File to read.
        start: First particle.
        stop: Particle after the last one.
    """
    with run_reader.opened(Path(path)) as f:
        names = [d.name for d in file_layout.GAUSSIAN if d.name in f]
        return {name: f[name][start:stop] for name in names}


def preparation_hash(path: str | Path) -> str:
    """Return the hash of the preparation that the file stores; "" if there is no such file."""
    try:
        with run_reader.opened(Path(path)) as f:
            return f.attrs["digest"].decode()
    except run_reader.RunError:
        return ""
