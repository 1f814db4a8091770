"""The colours of a run's particles at a frame, where colour travels between them.

Worked out from the files of the run alone: positions and volumes of its frames and the colours at
the start. So a run is never made again for another look of its colours.

frame: the colours at the start, smoothed once over a cell where the particles are now.
relax: dc/dt = (S c - c) / time from frame to frame, S the smoothing at the frame where a stretch of
time ends (vgmpi/splatting/smoothing.py). The colours of each frame are kept in OUT/colours.
step: the run has carried them itself; they stand in its frames.
"""

import hashlib
import logging
import os
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from postprocess.settings import LookSettings, SettingsError
from vgmpi.gaussians.sh import COEFFICIENTS
from vgmpi.output.read import RunError
from vgmpi.splatting.smoothing import MOST_AGE, Transfer

log = logging.getLogger("vgmpi")

FOLDER = "colours"  # in the folder of the run
VERSION = 1  # raised when the same settings give other colours


class FrameColours:
    """Colours of the frames of one run. run: vgmpi.output.read.RunFiles. Raises SettingsError."""

    def __init__(self, run: Any, chosen: LookSettings):
        self.run = run
        scene = getattr(run, "scene", None) or {}
        told = {**scene.get("appearance", {}), **chosen.colours()}
        self.mode = told.get("colour_transfer", "off")
        self.time = float(told.get("colour_time", 1.0))
        self.degree = int(told.get("colour_degree", 0))
        self.dx = float(scene.get("domain", {}).get("cell", 0.0))
        travel = self.mode in ("frame", "relax")
        sets = _sets(run.objects, told.get("colour_bodies")) if travel else []
        if sets and scene.get("coupling") and not all("colour_set" in o for o in run.objects):
            log.warning("%s: made by a version that did not tell which fluids exchange colours: "
                        "they travel within a phase alone", run.folder)  # fmt: skip
        if sets and not self.dx:
            raise SettingsError(["look.colour_transfer: the run does not tell the size of a cell"])
        object_ = np.asarray(run.gaussians.object)
        sh = np.asarray(run.gaussians.sh)
        count = min(COEFFICIENTS[self.degree], sh.shape[1])
        self.set = np.full(len(object_), -1, np.int32)  # of each particle
        for number, members in enumerate(sets):
            mine = np.isin(object_, members)
            if mine.any() and (sh[mine, :count] != sh[mine][0, :count]).any():
                self.set[mine] = number  # where all are equal, nothing changes
        # the higher degrees of a body that turns are told in axes that turn with it
        turns = [any(run.objects[k].get("family") == "solid" for k in members) for members in sets]
        self.columns = [3 if turn else 3 * count for turn in turns]
        self.ids = np.flatnonzero(self.set >= 0)
        self.shape = (len(self.ids), 3 * count)
        self.first = sh[self.ids, :count].astype(np.float64).reshape(self.shape)
        self._row = np.cumsum(self.set >= 0) - 1  # of a particle in these arrays
        self._unwritable = False
        self._last: tuple[int, np.ndarray] | None = None

    def at(self, index: int, frame: dict[str, np.ndarray]) -> np.ndarray | None:
        """Coefficients (n, K, 3) of the rows of frame `index`; None where they are those at rest.

        frame: what run.frame(index) gives.
        """
        if "colour" in frame and self.mode == "step":
            return self._carried(frame)
        if not len(self.ids):
            return None
        ids = np.asarray(frame["id"])
        sh = np.asarray(self.run.gaussians.sh)[ids]
        if self.mode == "frame":
            state = self._moved(frame, self.first, None)
        else:
            state = self._relaxed(index, frame)
        taking = np.flatnonzero(self.set[ids] >= 0)
        changed = state[self._row[ids[taking]]].reshape(len(taking), -1, 3)
        sh[taking, : changed.shape[1]] = changed
        return sh

    def _carried(self, frame: dict[str, np.ndarray]) -> np.ndarray:
        """Coefficients of the rows of a frame that tells those that have travelled."""
        sh = np.asarray(self.run.gaussians.sh)[np.asarray(frame["id"])]
        told = np.asarray(frame["colour"]).reshape(len(sh), -1, 3)
        some = sh[:, : told.shape[1]]
        np.copyto(some, told, where=~np.isnan(told))
        return sh

    def prepare(self, index: int) -> None:
        """Work out and keep what the frames up to `index` need, before processes share them."""
        if len(self.ids) and self.mode == "relax":
            self._relaxed(index, self.run.frame(index))

    def _moved(self, frame: dict, state: np.ndarray, age: float | None) -> np.ndarray:
        """The colours `state` (self.shape) after a transfer at the positions of a frame: one
        smoothing, or `age` relaxation times."""
        ids = np.asarray(frame["id"])
        volume = np.asarray(self.run.gaussians.vol0, dtype=np.float64)[ids]
        if "J" in frame:
            volume = volume * np.asarray(frame["J"], dtype=np.float64)
        out = state.copy()
        for number in range(self.set.max() + 1):
            here = np.flatnonzero(self.set[ids] == number)
            here = here[np.argsort(ids[here], kind="stable")]
            if not len(here):
                continue
            transfer = Transfer(np.asarray(frame["x"])[here], volume[here], self.dx)
            rows, columns = self._row[ids[here]], self.columns[number]
            old = state[rows, :columns]
            new = transfer.smoothed(old) if age is None else transfer.relaxed(old, age)
            out[rows, :columns] = new
        return out

    def _relaxed(self, index: int, frame: dict) -> np.ndarray:
        """Colours of frame `index`: those of the latest frame before it that is known, brought
        forward frame by frame."""
        keys = list(self._keys(index))
        start, state = 0, self.first
        if self._last is not None and self._last[0] <= index:
            start, state = self._last
        for known in range(index, start, -1):
            found = self._read(known, keys[known])
            if found is not None:
                start, state = known, found
                break
        for k in range(start + 1, index + 1):
            age = float(self.run.times[k] - self.run.times[k - 1]) / self.time
            if age > MOST_AGE:
                least = age * self.time / MOST_AGE
                said = f"{self.time:g} s is too short for this run's frames: at least {least:.3g} s"
                raise SettingsError([f"colour_time: {said}"])
            state = self._moved(frame if k == index else self.run.frame(k), state, age)
            self._write(k, keys[k], state)
        self._last = index, state
        return state

    def _keys(self, index: int) -> Iterator[str]:
        """What the colours of frames 0 .. index depend on, as a text each. Files are told apart by
        size and time of writing: reading all frames would take longer than one picture."""
        told = (VERSION, self.time, self.dx, self.columns)
        text = hashlib.sha256(repr(told).encode() + self.set.tobytes() + self.first.tobytes())
        for k in range(index + 1):
            path = self.run.path(k)
            try:
                stat = path.stat(follow_symlinks=False)
            except OSError as error:
                said = f"{path}: {error.strerror}: colours that relax need every frame"
                raise RunError(said) from None
            said = (path.name, stat.st_size, stat.st_mtime_ns, float(self.run.times[k]))
            text.update(repr(said).encode())
            yield text.hexdigest()

    def _path(self, index: int) -> Path:
        return Path(self.run.folder) / FOLDER / f"{self.run.path(index).stem}.npz"

    def _read(self, index: int, key: str) -> np.ndarray | None:
        """Colours kept under this key, or None: what is damaged or a link is made anew."""
        path = self._path(index)
        try:
            if path.is_symlink() or not path.is_file():
                return None
            with zipfile.ZipFile(path) as held:  # it holds a checksum of every array
                size = sum(info.file_size for info in held.infolist())
            if size > 4096 + self.first.nbytes:
                return None
            with np.load(path) as kept:
                if str(kept["key"]) == key and kept["colour"].shape == self.shape:
                    found = kept["colour"]
                    return found if np.isfinite(found).all() else None
        except Exception:  # zipfile and numpy raise all kinds of what is in a file
            log.warning("%s: damaged: made anew", path)
        return None

    def _write(self, index: int, key: str, state: np.ndarray) -> None:
        if self._unwritable:
            return
        path = self._path(index)
        temporary = path.with_name(f"{path.stem}.{os.getpid()}.tmp")
        try:
            path.parent.mkdir(exist_ok=True)
            temporary.unlink(missing_ok=True)
            with open(temporary, "xb") as file:  # new: no link is followed
                np.savez(file, key=np.array(key), colour=state)
            temporary.replace(path)  # other processes see all of it or nothing
        except OSError as error:
            self._unwritable = True
            log.warning("%s: the colours of frames cannot be kept: %s", path.parent, error)


def _sets(objects: list[dict], asked: Any) -> list[list[int]]:
    """Numbers of the objects that exchange colour among themselves, a list for each such set.

    asked: names of the bodies that take part, None for all fluids.
    """
    names = [entry.get("name") for entry in objects]
    bodies = [k for k, entry in enumerate(objects) if entry.get("material") or entry.get("family")]
    if asked is None:
        taking = [k for k in bodies if objects[k].get("family") == "fluid"]
    else:
        known = [names[k] for k in bodies]
        wrong = [name for name in asked if name not in known]
        if wrong:
            said = f"there is no body {wrong[0]!r}; known: {', '.join(map(str, known))}"
            raise SettingsError([f"colour_bodies: {said}"])
        taking = [k for k in bodies if names[k] in asked]
    sets: dict[Any, list[int]] = {}
    for k in taking:
        # files made before colour_set was told have the phase alone
        sets.setdefault(objects[k].get("colour_set", objects[k].get("phase")), []).append(k)
    return sorted(sets.values())
