"""Registry of Gaussian file formats, selected by the suffix of the name."""

from collections.abc import Callable
from pathlib import Path

from vgmpi.gaussians.capture_conventions import in_ply_frame
from vgmpi.gaussians.cloud import GaussianCloud

from . import gltf, ply, sog, spz
from .splat import read_ksplat, read_splat, write_splat
from .validation import GaussianFileError

GLTF, SOG, SPZ = ".glb", ".sog", ".spz"
COMPRESSED = ".compressed.ply"  # suffix of a .ply in SuperSplat's layout
KINDS: dict[str, Callable[[str | Path], GaussianCloud]] = {  # readers
    ".ply": ply.read,
    ".splat": read_splat,
    SPZ: spz.read,
    SOG: sog.read,
    GLTF: gltf.read,
    ".gltf": gltf.read,
    ".ksplat": read_ksplat,
}
_WRITERS: dict[str, Callable[[str | Path, GaussianCloud], None]] = {
    ".ply": ply.write,
    ".splat": write_splat,
    SPZ: spz.write,
    COMPRESSED: ply.write_compressed,
    GLTF: gltf.write,
    SOG: sog.write,
}
WRITTEN = tuple(_WRITERS)  # suffixes of files that are written
_CONVERSION = "convert it to .ply or .sog, for example with splat-transform (PlayCanvas)"
UNREADABLE = {  # formats of Gaussians that are not read
    ".lcc": "XGRIDS's LCC",
    ".lcc2": "XGRIDS's LCC",
    ".rad": "Spark's RAD",
    ".4dgs": "a moving 4DGS capture",
    ".splat4d": "a moving 4DGS capture",
    ".splatv": "a moving capture of antimatter15's viewer",
    ".sogs": "an unbundled SOG",
    ".json": "an unbundled SOG (meta.json) or a list of files",
    ".pt": "a checkpoint of PyTorch",
    ".pth": "a checkpoint of PyTorch",
    ".ckpt": "a checkpoint of PyTorch",
}


def read(path: str | Path, frame: str | None = None) -> GaussianCloud:
    """Return the Gaussians of a file in the file's units and in the axes that its .ply would have.

    Values are activated: opacity in 0..1, linear scales, unit quaternions. Numbers are
    taken as they are unless the format, the file or the caller names another frame.

    Args:
        path: The file.
        frame: Directions of x, y and z in the file, such as "RUB"; default: what the file says.

    Raises:
        GaussianFileError: If the file is not readable.
        ValueError: If the name is not that of a frame.
    """
    return in_ply_frame(_reader(path)(path), frame, Path(path).suffix.lower())


def write(path: str | Path, cloud: GaussianCloud, spz_version: int = spz.DEFAULT_VERSION) -> None:
    """Write `cloud` in the format of the name, replacing the file at once.

    Args:
        path: The file.
        cloud: Gaussians in the axes that a .ply would have.
        spz_version: Version of a .spz, 3 or 4.

    Raises:
        GaussianFileError: If the format cannot hold the cloud, or is only read.
        OSError: If the file cannot be written.
    """
    name = Path(path).name.lower()
    suffixes = [suffix for suffix in WRITTEN if name.endswith(suffix)]
    if not suffixes:
        _reader(path)
        raise GaussianFileError(
            f"{path}: this format is only read: written are {', '.join(WRITTEN)}"
        )
    suffix = max(suffixes, key=len)  # a compressed .ply ends in .ply, too
    if suffix == SPZ:
        spz.write(path, cloud, spz_version)
    else:
        _WRITERS[suffix](path, cloud)


def _reader(path: str | Path) -> Callable[[str | Path], GaussianCloud]:
    """Return the reader of a file's format."""
    suffix = Path(path).suffix.lower()
    if suffix in UNREADABLE:
        raise GaussianFileError(f"{path}: is {UNREADABLE[suffix]}, not read: {_CONVERSION}")
    if suffix not in KINDS:
        raise GaussianFileError(f"{path}: allowed: a name that ends in {', '.join(KINDS)}")
    return KINDS[suffix]
