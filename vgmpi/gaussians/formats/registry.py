"""Registry of Gaussian file formats, selected by the suffix of the name."""

from pathlib import Path
from types import ModuleType

from vgmpi.gaussians.cloud import GaussianCloud

from . import gltf, ply, sog, splat, spz
from .validation import GaussianFileError

KINDS: dict[str, ModuleType] = {".ply": ply, ".splat": splat, ".spz": spz}
GLTF, SOG = ".glb", ".sog"  # write-only formats
COMPRESSED = ".compressed.ply"  # suffix of a .ply in SuperSplat's layout


def read(path: str | Path) -> GaussianCloud:
    """Return the Gaussians of a .ply, .splat or .spz file in the file's units.

    Values are activated: opacity in 0..1, linear scales, unit quaternions.

    Raises:
        GaussianFileError: If the file is not readable.
    """
    return _format_module(path).read(path)


def write(path: str | Path, cloud: GaussianCloud) -> None:
    """Write `cloud` in the format of the name, replacing the file at once.

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
    else:
        _format_module(path).write(path, cloud)


def _format_module(path: str | Path) -> ModuleType:
    """Return the module of a file's format."""
    suffix = Path(path).suffix.lower()
    if suffix not in KINDS:
        raise GaussianFileError(f"{path}: allowed: a name that ends in {', '.join(KINDS)}")
    return KINDS[suffix]
