"""Where the bodies of a configuration stand in their box, and which Gaussians they are made of.

Their way: Gaussians fainter than a threshold are dropped, the others turned about the axes one
after the other, then moved and scaled so that the longest edge of the box around them is `scale`
and its middle (1, 1, 1), or `center_point`.
"""

import math
import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vgmpi.convert import keys
from vgmpi.convert.reading import Body, Config, ConvertError, Report, Where, refused
from vgmpi.gaussians import files
from vgmpi.gaussians.checked import GaussianFileError
from vgmpi.tables import got

CENTRE = (1.0, 1.0, 1.0)
CORNERS = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)], dtype=float)


class Standing(NamedTuple):
    """A body in their box. low, high: its corners (3,); x: its Gaussians (n, 3), None where no file
    is known; scale, origin: what takes turned coordinates of the file there; box: the part of the
    file (2, 3) that it is made of, in the file's axes; area: the part beyond which its Gaussians
    are only drawn; own: all Gaussians of the file (m, 3) that are not too faint."""

    name: str
    file: Path | None
    low: np.ndarray
    high: np.ndarray
    x: np.ndarray | None = None
    scale: float = 1.0
    origin: np.ndarray = np.zeros(3)
    turned: np.ndarray = np.eye(3)
    box: np.ndarray | None = None
    area: np.ndarray | None = None
    own: np.ndarray = np.zeros((0, 3))

    @property
    def straight(self) -> bool:
        """Whether a box in their box is one along the axes of the file."""
        return along_axes(self.turned)

    def in_file(self, box: np.ndarray) -> np.ndarray:
        """A box (2, 3) of theirs in the file's axes."""
        ends = (box - self.origin) / self.scale @ self.turned
        return np.array([ends.min(axis=0), ends.max(axis=0)])

    def inside(self, within: Any) -> float:
        """The share of it for which within((n, 3)) holds; of one without Gaussians 1, 0 or .5, by
        its corners and middle: a region is convex."""
        if self.x is not None:
            return float(np.mean(within(self.x)))
        points = self.low + CORNERS * (self.high - self.low)
        found = np.mean(within(points))
        if found == 1.0:
            return 1.0
        lattice = np.stack(np.meshgrid(*[np.linspace(0, 1, 21)] * 3), axis=-1).reshape(-1, 3)
        return 0.5 if np.any(within(self.low + lattice * (self.high - self.low))) else 0.0


def in_box(point: keys.Vector, size: keys.Extent):
    """Whether points (n, 3) lie within `size` of `point` along each axis, as theirs asks."""
    return lambda x: (np.abs(x - np.asarray(point)) < np.asarray(size)).all(axis=1)


def stand(config: Config, k: int, file: Path | None, report: Report, taken: set[str]) -> Standing:
    """Body k in their box. taken: the names so far. Raises ConvertError."""
    body = config.bodies[k]
    name = _name(body, file, taken)
    centre = np.asarray(getattr(body.stand, "center_point", CENTRE))
    if file is None:
        half = np.full(3, body.stand.scale / 2)
        if getattr(body.law, "type", None) == "floor":
            half[2] = config.cell  # a plate, as thick as it must be
        for key in ("rotation_degree", "rotation_axis", "opacity_threshold"):
            if body.stand.given(key):
                why = "there is no Gaussian file to apply it to (--gaussians)"
                report.lost((*body.stand_at, key), getattr(body.stand, key), why)
        for key in _areas(body):
            why = "it is cut out of a Gaussian file, which is not here (--gaussians)"
            report.lost((*body.stand_at, key), getattr(body.stand, key), why)
        return Standing(name, None, centre - half, centre + half)
    return _of_file(config, body, file, report, Standing(name, file, centre, centre))


def _of_file(config: Config, body: Body, file: Path, report: Report, at: Standing) -> Standing:
    try:
        cloud = files.read(file)
    except GaussianFileError as error:
        raise ConvertError([str(error)]) from None
    except OSError as error:
        raise ConvertError([f"{file}: {error.strerror or error}"]) from None
    own = cloud.x[cloud.opacity >= body.stand.opacity_threshold]
    rotation = turn(body.stand)
    x = own @ rotation.T
    boxes = {key: np.reshape(getattr(body.stand, key), (3, 2)).T for key in _areas(body)}
    if not config.several and "sim_area" in boxes:  # before they scale
        x = x[_within(x, boxes["sim_area"])]
    if len(x) == 0:
        raise _nothing(config, body, file)
    low, high = x.min(axis=0), x.max(axis=0)
    if not (high - low).max() > 0:
        raise ConvertError([f"{file}: all its Gaussians are at one point: no scale is known"])
    scale = body.stand.scale / (high - low).max()
    origin = at.low - scale * (low + high) / 2
    x = scale * x + origin
    if config.several:
        for box in boxes.values():
            x = x[_within(x, box)]
        boxes = {key: (box - origin) / scale for key, box in boxes.items()}
    if len(x) == 0:
        raise _nothing(config, body, file)
    part, area = _cut(body, boxes, rotation, report)
    if boxes and part is None:  # all of the file is in the scene
        x = scale * own @ rotation.T + origin
    return at._replace(
        low=x.min(axis=0), high=x.max(axis=0), x=x, scale=float(scale), origin=origin,
        turned=rotation, box=part, area=area, own=own,
    )  # fmt: skip


def _nothing(config: Config, body: Body, file: Path) -> ConvertError:
    key = next(iter(_areas(body)), "opacity_threshold")
    said = f"leaves no Gaussian of {file}; {got(getattr(body.stand, key))}"
    return refused(config.path, (*body.stand_at, key), said)


def _areas(body: Body) -> list[str]:
    names = ("sim_area", "sim_selected_area", "object_area")
    return [key for key in names if getattr(body.stand, key, None) is not None]


def _within(x: np.ndarray, box: np.ndarray) -> np.ndarray:
    return ((x > box[0]) & (x < box[1])).all(axis=1)


def _cut(
    body: Body, boxes: dict[str, np.ndarray], rotation: np.ndarray, report: Report
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """The boxes in turned coordinates as one box (2, 3) along the file's own axes, and sim_area."""
    part = area = None
    straight = along_axes(rotation)
    for key, box in boxes.items():
        at, value = (*body.stand_at, key), getattr(body.stand, key)
        if not straight:
            why = "a part of a file is a box along its own axes, which the rotation turns away"
            report.lost(at, value, why)
            continue
        ends = box @ rotation
        low, high = ends.min(axis=0), ends.max(axis=0)
        part = np.array([low, high]) if part is None else np.array(
            [np.maximum(part[0], low), np.minimum(part[1], high)]
        )  # fmt: skip
        if key == "sim_area":
            area = np.array([low, high])
        elif key == "object_area" and body.stand.particle_filling is not None:
            report.partly(at, value, "it is cut before it is filled, theirs after")
    return part, area


def around(box: np.ndarray, outer: np.ndarray) -> list[np.ndarray]:
    """What is left of a box (2, 3) without another, as boxes side by side."""
    found, left = [], outer.copy()
    for axis in range(3):
        for side, sign in ((0, 1), (1, -1)):
            if sign * (box[side][axis] - left[side][axis]) > 0:
                piece = left.copy()
                piece[1 - side][axis] = box[side][axis]
                found.append(piece)
                left[side][axis] = box[side][axis]
    return found


def turn(stand: keys.Stand) -> np.ndarray:
    """Their rotations one after the other (3, 3)."""
    out = np.eye(3)
    for angle, axis in zip(stand.rotation_degree, stand.rotation_axis, strict=True):
        c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
        one, i, j = np.eye(3), (axis + 1) % 3, (axis + 2) % 3
        one[i, i] = one[j, j] = c
        one[j, i], one[i, j] = s, -s
        out = one @ out
    return out


def along_axes(rotation: np.ndarray) -> bool:
    """Whether it takes axes to axes."""
    return bool(np.allclose(np.abs(rotation).max(axis=1), 1.0, atol=1e-9))


def find_file(config: Config, k: int, given: list[Path]) -> tuple[Path | None, str]:
    """The Gaussian file of body k and why there is none. given: those of --gaussians, in order of
    the bodies. A folder is one of Gaussian splatting's own, of which the last iteration counts.
    Raises ConvertError where one that is given is not there."""
    if k < len(given):
        file = _of_model(given[k])
        if file is None:
            raise ConvertError([f"{given[k]}: there is no such Gaussian file"])
        return file, ""
    if not config.several:
        return None, "--gaussians FILE names it"
    named = config.bodies[k].stand.model_path  # type: ignore[attr-defined]
    if "\0" in named:
        return None, "no file has such a name"
    # as theirs, from the folder it is started in; or from the one that holds config/
    for folder in (Path(), config.path.parent, config.path.parent.parent):
        file = _of_model(folder / named)
        if file is not None:
            return file, ""
    return None, f"{named} is not here; --gaussians names the files of all bodies in order"


def _of_model(path: Path) -> Path | None:
    if path.is_file():
        return path
    rounds = [
        (int(found[1]), folder)
        for folder in (path / "point_cloud").glob("iteration_*")
        if (found := re.fullmatch(r"iteration_(\d{1,9})", folder.name))
    ]
    last = max(rounds, default=(0, path))[1] / "point_cloud.ply"
    return last if last.is_file() else None


def _name(body: Body, file: Path | None, taken: set[str]) -> str:
    """A name of its own, after its file."""
    stem = Path(getattr(body.stand, "model_path", file or "body")).stem
    if stem == "point_cloud":
        stem = "body"
    name = re.sub(r"[^\w -]", "_", stem).strip() or "body"
    name = name if name[0].isalpha() else f"body {name}"
    first, count = name, 1
    while name in taken:
        count += 1
        name = f"{first} {count}"
    taken.add(name)
    return name


def place(body: Body) -> Where:
    """Where the key stands that says where a body is."""
    return (*body.stand_at, "center_point" if body.stand_at else "scale")
