"""Gaussian files of any kind, told by the end of their name."""

from pathlib import Path
from types import ModuleType

from vgmpi.gaussians import dotsplat, glb, ply, spz
from vgmpi.gaussians.checked import GaussianFileError
from vgmpi.gaussians.cloud import Cloud

KINDS: dict[str, ModuleType] = {".ply": ply, ".splat": dotsplat, ".spz": spz}
GLTF = ".glb"  # is only written
COMPRESSED = ".compressed.ply"  # the end of a .ply that is to be written in SuperSplat's layout


def read(path: str | Path) -> Cloud:
    """The Gaussians of a .ply, .splat or .spz file, activated (opacity in 0..1, linear scales,
    unit quaternions), in the file's units. Raises GaussianFileError.
    """
    return _kind(path).read(path)


def write(path: str | Path, cloud: Cloud) -> None:
    """Write `cloud` as the name says, replacing the file at once.

    Raises GaussianFileError, OSError.
    """
    name = Path(path).name.lower()
    if name.endswith(GLTF):
        glb.write(path, cloud)
    elif name.endswith(COMPRESSED):
        ply.write_compressed(path, cloud)
    else:
        _kind(path).write(path, cloud)


def _kind(path: str | Path) -> ModuleType:
    suffix = Path(path).suffix.lower()
    if suffix not in KINDS:
        raise GaussianFileError(f"{path}: allowed: a name that ends in {', '.join(KINDS)}")
    return KINDS[suffix]
