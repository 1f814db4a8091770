"""Colors of particles at a frame, with transfer of color between particles.

Colors are computed from the files of the run alone: positions and volumes of its frames and the
initial colors. A run is never repeated for other color settings.

frame: the initial colors are smoothed once over a cell at the current positions.
relax: dc/dt = (S c - c) / time from frame to frame, with the smoothing S of the frame at the end of
an interval (vgmpi/gaussians/color_diffusion.py). The colors of each frame are cached in
OUT/colors.
step: the run has transferred the colors itself, and its frames hold them.
"""

import hashlib
import logging
import os
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from vgmpi.gaussians.color_diffusion import MAX_RELAXATION, Transfer
from vgmpi.gaussians.spherical_harmonics import COEFFICIENTS
from vgmpi.io.run_reader import RunError

from .render_config import LookSettings, SettingsError

log = logging.getLogger("vgmpi")

FOLDER = "colors"  # name of the cache folder in the run
VERSION = 1  # raised if the same settings give other colors


class FrameColors:
    """Colors of the frames of one run, vgmpi.io.run_reader.RunReader. Raises SettingsError."""

    def __init__(self, run: Any, chosen: LookSettings):
        self.run = run
        scene = getattr(run, "scene", None) or {}
        options = {**scene.get("appearance", {}), **chosen.colors()}
        self.mode = options.get("color_transfer", "off")
        self.time = float(options.get("color_relaxation_time", 1.0))
        self.degree = int(options.get("color_sh_degree", 0))
        self.dx = float(scene.get("domain", {}).get("cell", 0.0))
        has_transfer = self.mode in ("frame", "relax")
        sets = _color_sets(run.objects, options.get("color_objects")) if has_transfer else []
        if sets and scene.get("coupling") and not all("color_group" in o for o in run.objects):
            log.warning("%s: made by a version that did not tell which fluids exchange colors: "
                        "they travel within a phase alone", run.folder)  # fmt: skip
        if sets and not self.dx:
            raise SettingsError(["look.color_transfer: the run does not tell the size of a cell"])
        object_ = np.asarray(run.gaussians.object)
        sh = np.asarray(run.gaussians.sh)
        count = min(COEFFICIENTS[self.degree], sh.shape[1])
        self.set = np.full(len(object_), -1, np.int32)  # of each particle
        for number, members in enumerate(sets):
            is_member = np.isin(object_, members)
            if is_member.any() and (sh[is_member, :count] != sh[is_member][0, :count]).any():
                self.set[is_member] = number  # if all are equal, nothing changes
        # the higher degrees of a rotating body refer to axes that rotate with it
        rotates = [
            any(run.objects[k].get("family") == "solid" for k in members) for members in sets
        ]
        self.columns = [3 if is_rotating else 3 * count for is_rotating in rotates]
        self.ids = np.flatnonzero(self.set >= 0)
        self.shape = (len(self.ids), 3 * count)
        self.first = sh[self.ids, :count].astype(np.float64).reshape(self.shape)
        self._row = np.cumsum(self.set >= 0) - 1  # of a particle in these arrays
        self._unwritable = False
        self._last: tuple[int, np.ndarray] | None = None

    def at_frame(self, index: int, frame: dict[str, np.ndarray]) -> np.ndarray | None:
        """Return coefficients (n, K, 3) of the rows of frame `index`, or None if unchanged.

        frame: result of run.frame(index).
        """
        if "color_sh" in frame and self.mode == "step":
            return self._from_frame(frame)
        if not len(self.ids):
            return None
        ids = np.asarray(frame["id"])
        sh = np.asarray(self.run.gaussians.sh)[ids]
        if self.mode == "frame":
            state = self._advance(frame, self.first, None)
        else:
            state = self._relax_to(index, frame)
        taking = np.flatnonzero(self.set[ids] >= 0)
        changed = state[self._row[ids[taking]]].reshape(len(taking), -1, 3)
        sh[taking, : changed.shape[1]] = changed
        return sh

    def _from_frame(self, frame: dict[str, np.ndarray]) -> np.ndarray:
        """Return the coefficients of a frame that holds transferred colors."""
        sh = np.asarray(self.run.gaussians.sh)[np.asarray(frame["id"])]
        coefficients = np.asarray(frame["color_sh"]).reshape(len(sh), -1, 3)
        transferred = sh[:, : coefficients.shape[1]]
        np.copyto(transferred, coefficients, where=~np.isnan(coefficients))
        return sh

    def prepare(self, index: int) -> None:
        """Compute and cache the colors up to frame `index` before processes share them."""
        if len(self.ids) and self.mode == "relax":
            self._relax_to(index, self.run.frame(index))

    def _advance(self, frame: dict, state: np.ndarray, age: float | None) -> np.ndarray:
        """Apply one transfer to the colors `state` (self.shape) at the positions of a frame.

        The transfer is one smoothing, or `age` relaxation times.
        """
        ids = np.asarray(frame["id"])
        volume = np.asarray(self.run.gaussians.vol0, dtype=np.float64)[ids]
        if "J" in frame:
            volume = volume * np.asarray(frame["J"], dtype=np.float64)
        out = state.copy()
        for number in range(self.set.max() + 1):
            members = np.flatnonzero(self.set[ids] == number)
            members = members[np.argsort(ids[members], kind="stable")]
            if not len(members):
                continue
            transfer = Transfer(np.asarray(frame["positions"])[members], volume[members], self.dx)
            rows, columns = self._row[ids[members]], self.columns[number]
            old = state[rows, :columns]
            new = transfer.smoothed(old) if age is None else transfer.relax(old, age)
            out[rows, :columns] = new
        return out

    def _relax_to(self, index: int, frame: dict) -> np.ndarray:
        """Return the colors of frame `index`.

        They are advanced frame by frame from the latest cached frame before it.
        """
        keys = list(self._keys(index))
        start, state = 0, self.first
        if self._last is not None and self._last[0] <= index:
            start, state = self._last
        for cached_frame in range(index, start, -1):
            cached = self._read(cached_frame, keys[cached_frame])
            if cached is not None:
                start, state = cached_frame, cached
                break
        for k in range(start + 1, index + 1):
            age = float(self.run.times[k] - self.run.times[k - 1]) / self.time
            if age > MAX_RELAXATION:
                min_time = age * self.time / MAX_RELAXATION
                message = (
                    f"{self.time:g} s is too short for this run's frames: at least {min_time:.3g} s"
                )
                raise SettingsError([f"look.color_relaxation_time: {message}"])
            state = self._advance(frame if k == index else self.run.frame(k), state, age)
            self._write(k, keys[k], state)
        self._last = index, state
        return state

    def _keys(self, index: int) -> Iterator[str]:
        """Yield a hash of what the colors of each frame 0 .. index depend on.

        Files are identified by size and modification time; reading all frames would take longer
        than drawing one image.
        """
        parameters = (VERSION, self.time, self.dx, self.columns)
        text = hashlib.sha256(repr(parameters).encode() + self.set.tobytes() + self.first.tobytes())
        for k in range(index + 1):
            path = self.run.path(k)
            try:
                stat = path.stat(follow_symlinks=False)
            except OSError as error:
                description = f"{path}: {error.strerror}: colors that relax need every frame"
                raise RunError(description) from None
            identity = (path.name, stat.st_size, stat.st_mtime_ns, float(self.run.times[k]))
            text.update(repr(identity).encode())
            yield text.hexdigest()

    def _path(self, index: int) -> Path:
        """Return the path of the cached colors of a frame."""
        return Path(self.run.folder) / FOLDER / f"{self.run.path(index).stem}.npz"

    def _read(self, index: int, key: str) -> np.ndarray | None:
        """Return cached colors with this key, or None; damaged files and links are ignored."""
        path = self._path(index)
        try:
            if path.is_symlink() or not path.is_file():
                return None
            with zipfile.ZipFile(path) as archive:  # a zip file holds a checksum of every array
                size = sum(info.file_size for info in archive.infolist())
            if size > 4096 + self.first.nbytes:
                return None
            with np.load(path) as data:
                if str(data["key"]) == key and data["color"].shape == self.shape:
                    colors = data["color"]
                    return colors if np.isfinite(colors).all() else None
        except Exception:  # zipfile and numpy raise exceptions of many classes
            log.warning("%s: damaged: made anew", path)
        return None

    def _write(self, index: int, key: str, state: np.ndarray) -> None:
        """Cache the colors of a frame."""
        if self._unwritable:
            return
        path = self._path(index)
        temporary = path.with_name(f"{path.stem}.{os.getpid()}.tmp")
        try:
            path.parent.mkdir(exist_ok=True)
            temporary.unlink(missing_ok=True)
            with open(temporary, "xb") as file:  # exclusive creation follows no link
                np.savez(file, key=np.array(key), color=state)
            temporary.replace(path)  # the replacement is atomic for other processes
        except OSError as error:
            self._unwritable = True
            log.warning("%s: the colors of frames cannot be kept: %s", path.parent, error)


def _color_sets(objects: list[dict], requested: Any) -> list[list[int]]:
    """Return sets of objects that exchange color among themselves.

    requested: names of the bodies that take part, None for all fluids.
    """
    names = [entry.get("name") for entry in objects]
    bodies = [k for k, entry in enumerate(objects) if entry.get("material") or entry.get("family")]
    if requested is None:
        taking = [k for k in bodies if objects[k].get("family") == "fluid"]
    else:
        body_names = [names[k] for k in bodies]
        unknown = [name for name in requested if name not in body_names]
        if unknown:
            message = f"there is no body {unknown[0]!r}; known: {', '.join(map(str, body_names))}"
            raise SettingsError([f"look.color_objects: {message}"])
        taking = [k for k in bodies if names[k] in requested]
    sets: dict[Any, list[int]] = {}
    for k in taking:
        # files of versions before color_group hold the phase alone
        sets.setdefault(objects[k].get("color_group", objects[k].get("phase")), []).append(k)
    return sorted(sets.values())
