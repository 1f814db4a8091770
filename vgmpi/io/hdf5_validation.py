"""Structural validation of HDF5 files: groups and plain datasets of their own only.

Links out of the file, and datasets that claim more than it holds, are rejected before anything is
read.
"""

import math
import re

import h5py

from . import file_layout

MAX_DEPTH, MAX_ITEMS = (
    8,
    10_000,
)  # nesting of groups, items in a file: far above what the program writes
MAX_DEFLATION = 1032  # [-] largest ratio of gzip
MAX_CHUNK_BYTES = 1 << 24  # [bytes] of the numbers of a chunk
SOURCE = re.compile(rf"{file_layout.FRAMES}/([^/]+)")


class CorruptFileError(ValueError):
    """A file is damaged; the argument is one line without the file's name."""

    def __str__(self):
        """Return the line after the word damaged."""
        return f"damaged: {self.args[0]}"


class SchemaVersionError(CorruptFileError):
    """A file has another schema version, which this program would misread."""

    def __str__(self):
        """Return the line alone."""
        return self.args[0]


def check_structure(file: h5py.File, series: bool = False) -> None:
    """Check the structure of a file.

    Args:
        file: The open file.
        series: Allow datasets that refer to the frames beside the file.

    Raises:
        CorruptFileError: The structure is not one that the program writes; the text names the
            dataset.
    """
    size, left = file.id.get_filesize(), [("", file, 0)]
    item_count = 0
    while left:
        prefix, group, depth = left.pop()
        for key in group:
            name, item_count = f"{prefix}{key}", item_count + 1
            if not isinstance(group.get(key, getlink=True), h5py.HardLink):
                raise CorruptFileError(f"{name} is a link to elsewhere")
            if item_count > MAX_ITEMS or depth > MAX_DEPTH:
                raise CorruptFileError(f"{name} is one of too many groups and datasets")
            item = group[key]
            if isinstance(item, h5py.Group):
                left.append((f"{name}/", item, depth + 1))
            elif isinstance(item, h5py.Dataset):
                _check_dataset(name, item, size, series)
            else:
                raise CorruptFileError(f"{name} is neither a group nor a dataset")


def check_schema(file: h5py.File) -> None:
    """Check the schema of a file that names one. Raises SchemaVersionError."""
    schema = int(file.attrs.get("schema", file_layout.SCHEMA))
    if schema != file_layout.SCHEMA:
        raise SchemaVersionError(f"its schema is {schema}, this program's {file_layout.SCHEMA}")


def datasets(file: h5py.File) -> list[str]:
    """Return the names of all datasets."""
    names: list[str] = []
    file.visititems(
        lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None
    )
    return names


def _check_dataset(name, dataset, size, series):
    """Check that a dataset is stored plainly in the file, or refers to frames if `series`."""
    if series and dataset.is_virtual:
        if None in source_frames(dataset):
            raise CorruptFileError(f"{name} is put together of files that are no frames of the run")
        return
    if dataset.is_virtual or dataset.external:
        raise CorruptFileError(f"{name} keeps its numbers in another file")
    if dataset.dtype.kind not in "iufS" or dataset.shape is None:
        raise CorruptFileError(f"{name} is not stored as this program does it")
    if dataset.chunks is not None:
        if not _is_compressed_frame(dataset):
            raise CorruptFileError(f"{name} is not stored as this program does it")
        size = MAX_DEFLATION * min(size, dataset.id.get_storage_size())
    if math.prod(dataset.shape) * dataset.dtype.itemsize > size:
        raise CorruptFileError(f"{name} claims more bytes than the file has")


def _is_compressed_frame(dataset):
    """Return whether a dataset is compressed as frames are, in chunks of bounded size."""
    filters = dataset.id.get_create_plist().get_nfilters()
    return (
        (dataset.compression, dataset.shuffle, filters) == ("gzip", True, 2)
        and dataset.maxshape == dataset.shape
        and math.prod(dataset.chunks) * dataset.dtype.itemsize <= MAX_CHUNK_BYTES
    )


def source_frames(dataset: h5py.Dataset) -> list[int | None]:
    """Return the numbers of the frames that a series dataset refers to; None for other files."""
    return [_number(part) for part in dataset.virtual_sources()]


def _number(part):
    """Return the number of the frame that a virtual source is in, None for other files."""
    match = SOURCE.fullmatch(part.file_name)
    return file_layout.frame_number(match[1]) if match else None


def virtual_sources(dataset: h5py.Dataset) -> list[tuple]:
    """Return frame number, dataset name, first and last row of each source of a series dataset."""
    result = []
    for part in dataset.virtual_sources():
        rows = [int(bound[0]) for bound in part.vspace.get_select_bounds()]
        result.append((_number(part), part.dset_name, *rows))
    return result
