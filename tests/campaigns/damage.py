"""Damaged files of every kind that a run writes: each is named by who reads it, or does no harm.

Of a run that was stopped half-way. Its files are read as a renderer reads them and by --inspect,
and the run goes on: what is read is what was written, what comes out is what would have come out,
or one line names the file.
"""

import json
import logging
import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np

from tests.campaigns import cases, tiny
from tests.campaigns.result import Result
from tests.support import damaged_files
from vgmpi.io import file_layout
from vgmpi.io.run_reader import RunError, inspect
from vgmpi.solver import run as runs

NAME, COUNT, SMALL = "damage", 300, 24
STOP = 60  # steps
NEWEST = f"{file_layout.CHECKPOINTS}/{file_layout.CHECKPOINT_NAME.format(STOP)}"
OLDER = f"{file_layout.CHECKPOINTS}/{file_layout.CHECKPOINT_NAME.format(STOP - tiny.EVERY)}"
FILES = {  # by the kinds of damaged.LOOKS: one, and another of its kind
    "gaussians": (file_layout.GAUSSIANS, NEWEST),
    "frame": ("frames/frame_00001.vtkhdf", "frames/frame_00002.vtkhdf"),
    "series": (file_layout.SERIES, "frames/frame_00000.vtkhdf"),
    "checkpoint": (NEWEST, OLDER),
    "manifest": (NEWEST.replace(".h5", ".json"), OLDER.replace(".h5", ".json")),
    "ledger": (file_layout.LEDGER, "probe_tap.csv"),
    "probe": ("probe_tap.csv", file_layout.LEDGER),
}
TEXTS = ("manifest", "ledger", "probe")


def campaign(count: int, seed: int, folder: Path) -> Result:
    with tiny.undisturbed() as (scene, want):
        whole = scene.parent / "stopped"
        assert tiny.go(scene, whole, stop_steps=STOP) == runs.STOPPED

        def case(k: int, random: np.random.Generator, own: Path) -> str:
            kind = list(FILES)[k % len(FILES)]
            way = list(DAMAGES)[(k + k // len(FILES)) % len(DAMAGES)]  # few cases: all ways
            out, look = own / "out", damaged_files.LOOKS[kind][1]
            shutil.copytree(whole, out)
            path, other = (out / name for name in FILES[kind])
            before, described = look(path), _described(path, kind)
            DAMAGES[way](path, other, random)
            read = _read(path, look, before, cut=way == "cut off")
            told = _inspected(path, described)
            assert kind in TEXTS or told == "named" or read == "harmless", "--inspect is silent"
            ran = _resumed(scene, out, [path, other][: 1 + (way == "swapped")], want)
            return f"{kind} {way}: read {read}, inspected {told}, resumed {ran}"

        found = cases.each(count, seed, folder, case)
        return found._replace(counts=_by_outcome(found.counts))


def _by_outcome(counts: dict[str, int]) -> dict[str, int]:
    """Without the kinds of files and of damage, of which there are many."""
    found: dict[str, int] = {}
    for name, number in counts.items():
        outcome = name.partition(": ")[2].replace(",", " /")
        found[outcome] = found.get(outcome, 0) + number
    return found


def _read(path: Path, look: Callable[[Path], object], before, cut: bool) -> str:
    """ "named", "harmless", or of a table without its end "shorter"."""
    try:
        after = look(path)
    except damaged_files.SAID as error:
        _names(path, error)
        return "named"
    if cut and isinstance(before, list) and len(after) < len(before):
        assert _is_same(after, before[: len(after)]), "other rows are read in silence"
        return "shorter"
    assert _is_same(after, before), "other numbers are read in silence"
    return "harmless"


def _is_same(one, other) -> bool:
    """Equality, with rows of tables by their words: a ledger has no fill of solids (NaN)."""
    return repr(one) == repr(other) if isinstance(one, list) else one == other


def _names(path: Path, error: Exception) -> None:
    assert path.stem in str(error) and "\n" not in str(error), f"said: {error}"


def _described(path: Path, kind: str) -> str:
    return "" if kind in TEXTS else inspect(path)


def _inspected(path: Path, described: str) -> str:
    if not described:
        return "not at all"
    try:
        said = inspect(path)
    except RunError as error:
        _names(path, error)
        return "named"
    if "NOT VALID" in said:
        return "named"
    assert said == described, said
    return "harmless"


class _Heard(logging.Handler):
    """Warnings of a run."""

    def __init__(self):
        super().__init__(logging.WARNING)
        self.lines: list[str] = []

    def emit(self, record):
        self.lines.append(record.getMessage())


def _resumed(scene: Path, out: Path, touched: list[Path], want: dict[str, bytes]) -> str:
    """ "refused", "same files", or "warned" where a damaged file of the past stays as it is."""
    heard, log = _Heard(), logging.getLogger("vgmpi")
    log.addHandler(heard)
    try:
        code = tiny.go(scene, out, resume=True)
    except damaged_files.SAID as error:
        said = "; ".join([str(error), *heard.lines])
        assert any(path.stem in said for path in touched) and "\n" not in said, f"said: {said}"
        return "refused"
    finally:
        log.removeHandler(heard)
    assert code == runs.DONE
    names = {str(path.relative_to(out)) for path in touched}
    other = set(tiny.different(out, want))
    if not other:
        return "same files"
    free = names | {file_layout.SERIES}  # which leaves out a frame that is damaged
    if names & set(tiny.TABLES):  # one that begins anew is noted in the checkpoints from here on
        free |= {name for name in want if name.startswith(file_layout.CHECKPOINTS)}
    assert other <= free, other
    if any(path.stem in line for path in touched for line in heard.lines):
        return "warned"
    # bits of a frame's arrays are not looked at by a run, which never reads them
    frames = {name for name in names if name.startswith(file_layout.FRAMES)}
    assert other <= frames, f"{other} differ in silence"
    return "frame left as it is"


# ---- what is done to a file: (path, another file of its run, random) ---------------------------


def _flip(path: Path, other: Path, random: np.random.Generator) -> None:
    place = int(random.integers(path.stat().st_size))
    damaged_files.flip(path, place, int(random.integers(8)))


def _flip_data(path: Path, other: Path, random: np.random.Generator) -> None:
    """A bit of a number, where the file is of HDF5."""
    try:
        with h5py.File(path) as f:
            there: list[tuple[int, int]] = []
            f.visititems(
                lambda name, d: (
                    there.append((d.id.get_offset(), d.id.get_storage_size()))
                    if isinstance(d, h5py.Dataset) and d.id.get_offset() is not None and d.size
                    else None
                )
            )
    except OSError:
        return _flip(path, other, random)
    first, size = there[int(random.integers(len(there)))]
    damaged_files.flip(path, first + int(random.integers(size)), int(random.integers(8)))


def _cut(path: Path, other: Path, random: np.random.Generator) -> None:
    with open(path, "r+b") as f:
        f.truncate(int(random.integers(1, path.stat().st_size)))


def _swap(path: Path, other: Path, random: np.random.Generator) -> None:
    one, two = path.read_bytes(), other.read_bytes()
    path.write_bytes(two)
    other.write_bytes(one)


def _remove(path: Path, other: Path, random: np.random.Generator) -> None:
    path.unlink()


def _empty(path: Path, other: Path, random: np.random.Generator) -> None:
    path.write_bytes(b"")


def _foreign(path: Path, other: Path, random: np.random.Generator) -> None:
    """What other programs leave: any bytes, a text, a table, an HDF5 file."""
    some = [random.bytes(5000), b"hello\n", b"a,b\n1,2\n", json.dumps({"a": [1, 2]}).encode()]
    which = int(random.integers(len(some) + 1))
    path.unlink()
    if which < len(some):
        path.write_bytes(some[which])
        return
    with h5py.File(path, "w") as f:
        f["frames"] = np.arange(9)
        f.create_group("VTKHDF").attrs["Version"] = [2, 0]


DAMAGES: dict[str, Callable[[Path, Path, np.random.Generator], None]] = {
    "flipped": _flip,
    "flipped in data": _flip_data,
    "cut off": _cut,
    "swapped": _swap,
    "missing": _remove,
    "empty": _empty,
    "foreign": _foreign,
}
