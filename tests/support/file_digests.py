"""What the files of a run hold: their bytes, or one sha256 per dataset."""

import hashlib

import h5py


def files(folder) -> dict[str, bytes]:
    """Every file below a folder and its bytes."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def digests(folder) -> dict[str, str]:
    """sha256 of every dataset of every HDF5 file, and of every other file."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.suffix in (".h5", ".vtkhdf"):
            with h5py.File(path) as f:
                f.visititems(
                    lambda key, item, f=f, name=name: found.update(
                        {f"{name}:{key}": _sha(item[()])} if isinstance(item, h5py.Dataset) else {}
                    )
                )
        elif path.is_file():
            found[name] = _sha(path.read_bytes())
    return found


def _sha(value):
    data = value if isinstance(value, bytes) else value.tobytes()
    return hashlib.sha256(data).hexdigest()


def frame_digests(found: dict[str, str]) -> dict[str, str]:
    """Those of the frames and the ledger: a restart has checkpoints of its own."""
    return {name: sha for name, sha in found.items() if "frame_" in name or "ledger" in name}
