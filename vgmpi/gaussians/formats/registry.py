"""Registry of Gaussian file formats, selected by the suffix of the name."""

from pathlib import Path
from types import ModuleType

from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.coordinate_frames import in_ply_frame

from . import gltf, ply, sog, splat, spz
from .validation import GaussianFileError

SPZ = ".spz"
KINDS: dict[str, ModuleType] = {".ply": ply, ".splat": splat, SPZ: spz}
GLTF, SOG = ".glb", ".sog"  # write-only formats
COMPRESSED = ".compressed.ply"  # suffix of a .ply in SuperSplat's layout


def read(path: str | Path, frame: str | None = None) -> GaussianCloud:
    """Return the Gaussians of a .ply, .splat or .spz file in the file's units.

    Values are activated: opacity in 0..1, linear scales, unit quaternions. Axes are those of a
    .ply: numbers are taken as they are unless the file or the caller names another frame.

    Args:
        path: The file.
        frame: Directions of x, y and z in the file, such as "RUB"; default: what the file says.

    Raises:
        GaussianFileError: If the file is not readable.
        ValueError: If the name is not that of a frame.
    """
    module = _format_module(path)
    return in_ply_frame(module.read(path), frame, Path(path).suffix.lower())


def write(path: str | Path, cloud: GaussianCloud, spz_version: int = spz.DEFAULT_VERSION) -> None:
    """Write `cloud` in the format of the name, replacing the file at once.

    Args:
        path: The file.
        cloud: Gaussians in the axes that a .ply would have.
        spz_version: Version of a .spz, 3 or 4.

    Raises:
        GaussianFileError: If the format cannot hold the cloud.
        OSError: If the file cannot be written.
    """
    name = Path(path).name.lower()
    if name.endswith(GLTF):
        gltf.write(path, cloud)
    elif name.endswith(SOG):
        sog.write(path, cloud)
    elif name.endswith(COMPRESSED):
        ply.write_compressed(path, cloud)
    elif name.endswith(SPZ):
        spz.write(path, cloud, spz_version)
    else:
        _format_module(path).write(path, cloud)


def _format_module(path: str | Path) -> ModuleType:
    """Return the module of a file's format."""
    suffix = Path(path).suffix.lower()
    if suffix not in KINDS:
        raise GaussianFileError(f"{path}: allowed: a name that ends in {', '.join(KINDS)}")
    return KINDS[suffix]
