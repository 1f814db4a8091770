"""Reader and writer of .splat files, the layout of antimatter15's viewer: 32 bytes per Gaussian.

A row has three float32 of the center, three of the (linear) scale, red, green, blue, opacity as
bytes, and the quaternion w, x, y, z as bytes 128 q + 128. There is no header and no view-dependent
color.
"""

import os
from pathlib import Path

import numpy as np

from vgmpi.gaussians.cloud import CaptureRecord, GaussianCloud
from vgmpi.gaussians.spherical_harmonics import dc_from_rgb
from vgmpi.runtime.user_files import replace_file

from .validation import Columns, GaussianFileError, naming_file, read_validated
from .value_doubts import add_doubts

_ROW = np.dtype([("x", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)])
# the format has no magic number: these bytes begin files of other formats
_OTHER_FORMATS = {
    b"ply\n": "a .ply file",
    b"ply\r": "a .ply file",
    b"NGSP": "a .spz file",
    b"\x1f\x8b\x08": "a gzip file (.spz?)",
    b"\x89PNG": "a picture",
    b"PK\x03\x04": "a ZIP archive (.sog?)",
    b"RIFF": "a picture or a sound",
    b"<!DO": "a web page",
    b"<htm": "a web page",
    b"glTF": "a glTF file (.glb?)",
}


def read(path: str | Path) -> GaussianCloud:
    """Return the Gaussians of a .splat file.

    Raises:
        GaussianFileError: If the file is not readable.
    """
    with naming_file(path), open(path, "rb") as file:
        size, beginning = os.fstat(file.fileno()).st_size, file.read(64)
        for magic, kind in _OTHER_FORMATS.items():
            if beginning.startswith(magic):
                raise GaussianFileError(f"is not a .splat file, it begins like {kind}")
        if size and beginning.isascii() and beginning.decode().replace("\n", " ").isprintable():
            raise GaussianFileError("is not a .splat file, it is text")
        if size % _ROW.itemsize:
            raise GaussianFileError(
                f"has {size:,} bytes, no multiple of the {_ROW.itemsize} of a Gaussian: truncated,"
                " or no .splat file?"
            )

        def decoded(start: int, stop: int) -> Columns:
            """Decode a range of rows to columns."""
            file.seek(start * _ROW.itemsize)
            rows = np.fromfile(file, dtype=_ROW, count=stop - start)
            rgba = rows["rgba"] / 255.0
            return (
                rows["x"].astype(np.float64),
                rows["quat"] / 128.0 - 1.0,
                rows["scale"].astype(np.float64),
                rgba[:, 3],
                dc_from_rgb(rgba[:, :3])[:, None, :],
            )

        cloud = read_validated(size // _ROW.itemsize, decoded, CaptureRecord(encoding=".splat"))
        return add_doubts(cloud, has_log_scales=False, has_logits=False)


def write(path: str | Path, cloud: GaussianCloud) -> None:
    """Write `cloud`, in its order, without its view-dependent color.

    Raises:
        OSError: If the file cannot be written.
    """
    rows = np.empty(len(cloud), dtype=_ROW)
    rows["x"], rows["scale"] = cloud.x, cloud.scale
    rows["rgba"][:, :3] = np.rint(255 * cloud.rgb)
    rows["rgba"][:, 3] = np.rint(255 * np.clip(cloud.opacity, 0.0, 1.0))
    rows["quat"] = np.clip(np.rint(128 * cloud.quat + 128), 0, 255)
    replace_file(path, rows.tobytes())
