"""What an HDF5 file of a run is made of: groups and plain datasets of its own. Whatever leads out
of the file, or claims more than it holds, is refused before anything is read.
"""

import math
import re

import h5py

from vgmpi.output import layout

DEEPEST, MOST = 8, 10_000  # groups in each other, things in a file: far above what we write
SOURCE = re.compile(rf"{layout.FRAMES}/([^/]+)")


class Damaged(ValueError):
    """What is wrong with a file, in one line without its name."""

    def __str__(self):
        return f"damaged: {self.args[0]}"


class OtherSchema(Damaged):
    """A file of another version, which this one would read wrongly."""

    def __str__(self):
        return self.args[0]


def check(file: h5py.File, series: bool = False) -> None:
    """series: datasets may be put together of the frames beside the file. Raises Damaged, one
    line that names the dataset."""
    size, left = file.id.get_filesize(), [("", file, 0)]
    seen = 0
    while left:
        prefix, group, depth = left.pop()
        for key in group:
            name, seen = f"{prefix}{key}", seen + 1
            if not isinstance(group.get(key, getlink=True), h5py.HardLink):
                raise Damaged(f"{name} is a link to elsewhere")
            if seen > MOST or depth > DEEPEST:
                raise Damaged(f"{name} is one of too many groups and datasets")
            item = group[key]
            if isinstance(item, h5py.Group):
                left.append((f"{name}/", item, depth + 1))
            elif isinstance(item, h5py.Dataset):
                _check_dataset(name, item, size, series)
            else:
                raise Damaged(f"{name} is neither a group nor a dataset")


def datasets(file: h5py.File) -> list[str]:
    """Names of all datasets."""
    found: list[str] = []
    file.visititems(
        lambda name, item: found.append(name) if isinstance(item, h5py.Dataset) else None
    )
    return found


def _check_dataset(name, dataset, size, series):
    if series and dataset.is_virtual:
        if None in sources(dataset):
            raise Damaged(f"{name} is put together of files that are no frames of the run")
        return
    if dataset.is_virtual or dataset.external:
        raise Damaged(f"{name} keeps its numbers in another file")
    if dataset.chunks is not None or dataset.dtype.kind not in "iufS" or dataset.shape is None:
        raise Damaged(f"{name} is not stored as this program does it")
    if math.prod(dataset.shape) * dataset.dtype.itemsize > size:
        raise Damaged(f"{name} claims more bytes than the file has")


def sources(dataset: h5py.Dataset) -> list[int | None]:
    """Numbers of the frames that a dataset of the series is put together of; None for other
    files."""
    return [_number(part) for part in dataset.virtual_sources()]


def _number(part):
    match = SOURCE.fullmatch(part.file_name)
    return layout.frame_number(match[1]) if match else None


def parts(dataset: h5py.Dataset) -> list[tuple]:
    """Of what a dataset of the series is put together: number of the frame, name of its dataset,
    first and last row."""
    found = []
    for part in dataset.virtual_sources():
        rows = [int(bound[0]) for bound in part.vspace.get_select_bounds()]
        found.append((_number(part), part.dset_name, *rows))
    return found
