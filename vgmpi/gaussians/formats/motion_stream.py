"""Moving Gaussians in one stream of bytes: header, Gaussians at rest, frames.

The writer makes it frame by frame; the reader gives any frame of such a stream or page.
docs/reference/web-format.md describes it for other readers.
"""

import json
import struct
import zlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from vgmpi.gaussians.cloud import pack_symmetric, rotation_matrices, unpack_symmetric
from vgmpi.gaussians.spherical_harmonics import rgb_from_dc

from .residual_coding import MAX_BIN, CodedRows, deflate, inflate
from .validation import GaussianFileError

MAGIC = b"VGMPIWEB"
VERSION = 1
KEY_INTERVAL = 12  # [frames] from one key frame to the next

STATIC, POSED, FREE = "static", "posed", "free"  # how the centers of a group move
FIXED, SIZE, DEFORMATION = "fixed", "size", "deformation"  # how their shapes change
SHAPE_CHANNELS = {FIXED: 0, SIZE: 1, DEFORMATION: 10}
# [-] size of one unit of the stored integers; positions have a step of their own
STEPS = {"size": 1 / 128, "rotation": 1 / 64, "stretch": 1 / 64, "color": 1 / 100}
HOLD = 1.0  # [steps] change of a shape or color below which the stored integer stays


@dataclass(frozen=True)
class MotionGroup:
    """Consecutive Gaussians that move in the same manner.

    Attributes:
        name: Name of the object.
        count: Number of Gaussians.
        motion: STATIC, POSED (a rigid pose per frame) or FREE (a position per Gaussian and frame).
        shape: FIXED, SIZE (one factor) or DEFORMATION (rotation and stretch); FIXED unless FREE.
        color: Whether the colors are stored in each frame.
        pose: Index of the pose of a POSED group.
        compensated_lowpass: Variance of its antialiased training [pixels^2], 0 for none.
    """

    name: str
    count: int
    motion: str
    shape: str = FIXED
    color: bool = False
    pose: int = -1
    compensated_lowpass: float = 0.0

    @property
    def channels(self) -> int:
        """Number of integers per Gaussian and frame."""
        if self.motion != FREE:
            return 0
        return 3 + SHAPE_CHANNELS[self.shape] + 3 * self.color

    def to_json(self) -> dict[str, Any]:
        """Return its entry in the header, without the lowpass if it has none."""
        entry = asdict(self)
        if not self.compensated_lowpass:
            del entry["compensated_lowpass"]
        return entry


class RestGaussians(NamedTuple):
    """Values that do not change from frame to frame, in the order of the groups.

    Attributes:
        x: Centers at rest, shape (n, 3) [m].
        root: Square roots of the covariances at rest, upper triangles, shape (n, 6) [m].
        opacity: Opacities, shape (n,).
        sh: Color coefficients, shape (n, K, 3).
    """

    x: np.ndarray
    root: np.ndarray
    opacity: np.ndarray
    sh: np.ndarray


class GroupState(NamedTuple):
    """State of a FREE group in one frame.

    Attributes:
        present: Whether each Gaussian exists, shape (n,); the other arrays have a row for each
            that does.
        x: Centers, shape (m, 3) [m].
        size: Factors on the lengths of SIZE groups, shape (m,).
        quat: Rotations of DEFORMATION groups as w, x, y, z, shape (m, 4).
        stretch: Right stretches of DEFORMATION groups, upper triangles, shape (m, 6).
        color: Colors 0..1 without view dependence, shape (m, 3).
    """

    present: np.ndarray
    x: np.ndarray
    size: np.ndarray | None = None
    quat: np.ndarray | None = None
    stretch: np.ndarray | None = None
    color: np.ndarray | None = None


IDENTITY = np.array([1.0, 0, 0, 1, 0, 1])  # upper triangle of the unit matrix


class MotionWriter:
    """Encoder of rest Gaussians and frames.

    Raises GaussianFileError if the accuracy is too high for the extent of the positions.
    """

    def __init__(
        self,
        groups: Sequence[MotionGroup],
        gaussians: RestGaussians,
        *,
        cell: float,
        accuracy: float,
        key_interval: int = KEY_INTERVAL,
    ):
        """Encode what does not change.

        Args:
            groups: Groups in the order of the rows of `gaussians`.
            gaussians: Gaussians at rest.
            cell: Length that the accuracy refers to [m].
            accuracy: Largest error of a coordinate [cells].
            key_interval: Frames from one key frame to the next.
        """
        self.groups, self.rest_gaussians, self.key_interval = list(groups), gaussians, key_interval
        self.step = 2 * accuracy * cell
        self.origin = gaussians.x.min(axis=0) if len(gaussians.x) else np.zeros(3)
        self.header: dict[str, Any] = {
            "version": VERSION,
            "count": len(gaussians.x),
            "cell": cell,
            "accuracy": accuracy,
            "origin": self.origin.tolist(),
            "steps": {"position": self.step, **STEPS},
            "sh_coefficients": gaussians.sh.shape[1],
            "groups": [group.to_json() for group in self.groups],
        }
        starts = np.cumsum([0, *(group.count for group in self.groups)])
        self._coders = {k: CodedRows(g.count, g.channels) for k, g in self._free_groups()}
        self._bins = {}
        for k, group in self._free_groups():
            bins = np.zeros((group.count, group.channels), np.int32)
            bins[:, :3] = self._position_bins(gaussians.x[starts[k] : starts[k + 1]])
            self._bins[k] = bins
        self.frames: list[dict[str, Any]] = []
        self._blocks = [self._rest_block(starts)]

    def _free_groups(self) -> list[tuple[int, MotionGroup]]:
        """Return the FREE groups and their indices."""
        return [(k, g) for k, g in enumerate(self.groups) if g.motion == FREE]

    def _position_bins(self, x: np.ndarray) -> np.ndarray:
        """Return the integers of positions (n, 3). Raises GaussianFileError."""
        bins = np.rint((x - self.origin) / self.step)
        if len(bins) and not np.abs(bins).max() < MAX_BIN:
            distance = np.abs(x - self.origin).max()
            message = (
                f"{distance:.3g} m are no {MAX_BIN} steps of {self.step:.3g} m: lower the accuracy"
            )
            raise GaussianFileError(message)
        return bins.astype(np.int32)

    def _rest_block(self, starts: np.ndarray) -> bytes:
        """Return the compressed rest Gaussians."""
        gaussians = self.rest_gaussians
        pieces = [*_planes((gaussians.root / self.header["cell"]).astype("<f2"))]
        pieces += _planes(np.rint(np.clip(gaussians.opacity, 0, 1) * 65535).astype("<u2"))
        pieces += _planes(gaussians.sh[:, 0].astype("<f2"))
        higher = gaussians.sh[:, 1:].reshape(len(gaussians.sh), -1)
        max_value = float(np.abs(higher).max(initial=0.0))
        self.header["sh_step"] = max_value / 127 if max_value else 1.0
        pieces += _planes(np.rint(higher / self.header["sh_step"]).astype("i1"))
        for k, group in enumerate(self.groups):
            if group.motion != FREE:
                bins = self._position_bins(gaussians.x[starts[k] : starts[k + 1]])
                pieces += CodedRows(group.count, 3).encode(bins, True)
        return deflate(pieces)

    def add_frame(
        self, time: float, states: Sequence[GroupState], poses: Sequence[np.ndarray] = ()
    ) -> None:
        """Encode the next frame.

        Args:
            time: Simulated time [s].
            states: State of each FREE group, in the order of the groups.
            poses: Rigid poses (4, 4) of the POSED groups.

        Raises:
            GaussianFileError: If a position is too far away.
        """
        is_key = len(self.frames) % self.key_interval == 0
        pieces: list[bytes] = []
        for (k, group), state in zip(self._free_groups(), states, strict=True):
            present = np.asarray(state.present, bool)
            if present.all():
                pieces.append(b"\0")
            else:
                pieces.append(b"\1" + np.packbits(present, bitorder="little").tobytes())
            bins = self._bins[k].copy()  # absent Gaussians rest
            bins[present] = self._state_bins(group, state, bins[present])
            self._bins[k] = bins
            pieces += self._coders[k].encode(bins, is_key)
        block = deflate(pieces)
        entry: dict[str, Any] = {"time": float(time), "key": is_key, "bytes": len(block)}
        if len(poses):
            entry["poses"] = [np.asarray(pose)[:3].ravel().tolist() for pose in poses]
        self.frames.append(entry)
        self._blocks.append(block)

    def _state_bins(
        self, group: MotionGroup, state: GroupState, previous: np.ndarray
    ) -> np.ndarray:
        """Return the integers (m, channels) of the Gaussians that are present."""
        columns = [self._position_bins(state.x)]
        if group.shape == SIZE:
            assert state.size is not None
            columns.append(_held_bins(state.size[:, None] - 1, STEPS["size"], previous[:, 3:4]))
        if group.shape == DEFORMATION:
            assert state.quat is not None and state.stretch is not None
            # q and -q are the same rotation: the one nearer to the frame before changes less
            sign = np.where((state.quat * previous[:, 3:7]).sum(axis=1) < 0, -1, 1)
            quat = state.quat * sign[:, None]
            columns.append(_held_bins(quat, STEPS["rotation"], previous[:, 3:7]))
            stretch = state.stretch - IDENTITY
            columns.append(_held_bins(stretch, STEPS["stretch"], previous[:, 7:13]))
        if group.color:
            assert state.color is not None
            color = np.clip(state.color, 0, 4)
            columns.append(_held_bins(color, STEPS["color"], previous[:, -3:]))
        return np.concatenate(columns, axis=1)

    def to_bytes(self, view: dict[str, Any] | None = None) -> bytes:
        """Return all that was encoded; `view` holds hints for a viewer, any JSON."""
        offset = len(self._blocks[0])
        frames = []
        for entry in self.frames:
            frames.append({**entry, "offset": offset})
            offset += entry["bytes"]
        block = {"offset": 0, "bytes": len(self._blocks[0])}
        header = {**self.header, "rest": block, "frames": frames, "view": view or {}}
        text = json.dumps(header, separators=(",", ":")).encode()
        return b"".join([MAGIC, struct.pack("<I", len(text)), text, *self._blocks])


def _held_bins(values: np.ndarray, step: float, previous: np.ndarray) -> np.ndarray:
    """Return values in units of `step`, int32; those within HOLD of `previous` do not change."""
    scaled = values / step
    bins = np.where(np.abs(scaled - previous) <= HOLD, previous, np.rint(scaled))
    return bins.astype(np.int32)


def _planes(values: np.ndarray) -> list[bytes]:
    """Return the byte planes of an array (n, columns), column by column, low bytes first."""
    width, size = int(np.prod(values.shape[1:])), values.dtype.itemsize
    columns = np.ascontiguousarray(values.reshape(len(values), width).T)
    raw = columns.view(np.uint8).reshape(width, len(values), size)
    return [raw[c, :, k].tobytes() for c in range(width) for k in range(size)]


class MotionFrame(NamedTuple):
    """Gaussians of one frame; rows that are not present keep their last position.

    Attributes:
        present: Whether each Gaussian exists, shape (n,).
        x: Centers, shape (n, 3) [m].
        cov: Covariances, upper triangles, shape (n, 6) [m2].
        rotation: Rotations of shapes and colors, shape (n, 3, 3).
        rgb: Colors without view dependence, shape (n, 3).
    """

    present: np.ndarray
    x: np.ndarray
    cov: np.ndarray
    rotation: np.ndarray
    rgb: np.ndarray


class MotionReader:
    """Moving Gaussians of a stream of bytes. Raises GaussianFileError.

    Attributes:
        header: Header of the stream.
        groups: Groups in the order of the Gaussians.
        rest_gaussians: Gaussians at rest; positions of FREE groups are zero.
        times: Times of the frames, shape (frames,) [s].
    """

    def __init__(self, data: bytes):
        """Read header and rest Gaussians."""
        if data[: len(MAGIC)] != MAGIC:
            raise GaussianFileError("holds no moving Gaussians of vgmpi")
        try:
            (length,) = struct.unpack_from("<I", data, len(MAGIC))
            start = len(MAGIC) + 4
            self.header = json.loads(data[start : start + length])
            if self.header["version"] != VERSION:
                version = self.header["version"]
                raise GaussianFileError(f"has version {version}: allowed is {VERSION}")
            self._data, self._base = memoryview(data), start + length
            self.groups = [MotionGroup(**entry) for entry in self.header["groups"]]
            self.times = np.array([entry["time"] for entry in self.header["frames"]])
            blocks = [self.header["rest"], *self.header["frames"]]
            if sum(entry["bytes"] for entry in blocks) != len(data) - self._base:
                raise GaussianFileError("is damaged: its size is not that of its frames")
            self._starts = np.cumsum([0, *(group.count for group in self.groups)])
            self.rest_gaussians = self._read_rest()
        except (KeyError, TypeError, ValueError, IndexError, struct.error, zlib.error) as error:
            if isinstance(error, GaussianFileError):
                raise
            raise GaussianFileError(f"is damaged: {error}") from None
        self._coders: dict[int, CodedRows] = {}
        self._last = -1
        self._bins: list[tuple[np.ndarray, np.ndarray]] = []

    def __len__(self) -> int:
        return len(self.times)

    def _block(self, entry: dict) -> memoryview:
        """Return the content of a compressed block."""
        start = self._base + entry["offset"]
        return memoryview(inflate(bytes(self._data[start : start + entry["bytes"]])))

    def _read_rest(self) -> RestGaussians:
        """Return the Gaussians at rest."""
        block, n = self._block(self.header["rest"]), self.header["count"]
        terms, position = self.header["sh_coefficients"], 0
        columns = []
        for dtype, width in (("<f2", 6), ("<u2", 1), ("<f2", 3), ("i1", 3 * (terms - 1))):
            size = np.dtype(dtype).itemsize
            planes = np.frombuffer(block, np.uint8, width * size * n, position)
            rows = planes.reshape(width, size, n).transpose(2, 0, 1)
            columns.append(np.ascontiguousarray(rows).view(dtype)[..., 0].astype(np.float64))
            position += width * size * n
        root, opacity, dc, higher = columns
        sh = np.concatenate([dc, higher * self.header["sh_step"]], axis=1).reshape(n, terms, 3)
        x = np.zeros((n, 3))
        for k, group in enumerate(self.groups):
            if group.motion != FREE:
                bins, position = CodedRows(group.count, 3).decode(block, position, True)
                x[self._starts[k] : self._starts[k + 1]] = self.positions(bins)
        return RestGaussians(x, root * self.header["cell"], opacity[:, 0] / 65535, sh)

    def positions(self, bins: np.ndarray) -> np.ndarray:
        """Return the positions (n, 3) [m] of stored integers (n, 3)."""
        return np.array(self.header["origin"]) + self.header["steps"]["position"] * bins

    def bins(self, index: int) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return presence (n,) and integers (n, channels) of each FREE group in a frame.

        Raises:
            GaussianFileError: If a frame is damaged.
            IndexError: If there is no such frame.
        """
        frames = self.header["frames"]
        if not 0 <= index < len(frames):
            raise IndexError(f"no frame {index}, there are {len(frames)}")
        first = index
        while not frames[first]["key"]:
            first -= 1
        if first <= self._last <= index:  # the frames before are decoded already
            first = self._last + 1
        for number in range(first, index + 1):
            try:
                self._advance(number)
            except (ValueError, IndexError, zlib.error) as error:
                self._last = -1  # the coders are between two frames
                raise GaussianFileError(f"frame {number} is damaged: {error}") from None
        return self._bins

    def _advance(self, number: int) -> None:
        """Decode the frame after the last one, or a key frame."""
        entry, position = self.header["frames"][number], 0
        block = self._block(entry)
        decoded = []
        for k, group in enumerate(self.groups):
            if group.motion != FREE:
                continue
            coder = self._coders.setdefault(k, CodedRows(group.count, group.channels))
            present = np.ones(group.count, bool)
            has_mask = block[position]
            position += 1
            if has_mask:
                size = -(-group.count // 8)
                mask = np.frombuffer(block, np.uint8, size, position)
                present = np.unpackbits(mask, count=group.count, bitorder="little").astype(bool)
                position += size
            values, position = coder.decode(block, position, entry["key"])
            decoded.append((present, values))
        if position != len(block):
            raise ValueError(f"{len(block) - position} bytes are left over")
        self._bins, self._last = decoded, number

    def frame(self, index: int) -> MotionFrame:
        """Return the Gaussians of a frame."""
        n, steps = self.header["count"], self.header["steps"]
        x, present = self.rest_gaussians.x.copy(), np.ones(n, bool)
        rotation = np.tile(np.eye(3), (n, 1, 1))
        stretch = np.tile(np.eye(3), (n, 1, 1))
        rgb = rgb_from_dc(self.rest_gaussians.sh[:, 0])
        states = iter(self.bins(index))
        poses = self.header["frames"][index].get("poses", [])
        for k, group in enumerate(self.groups):
            rows = slice(self._starts[k], self._starts[k + 1])
            if group.motion == POSED:
                pose = np.array(poses[group.pose]).reshape(3, 4)
                x[rows] = x[rows] @ pose[:, :3].T + pose[:, 3]
                rotation[rows] = pose[:, :3]
            if group.motion != FREE:
                continue
            present[rows], bins = next(states)
            x[rows] = self.positions(bins[:, :3])
            if group.shape == SIZE:
                stretch[rows] *= (1 + bins[:, 3] * steps["size"])[:, None, None]
            if group.shape == DEFORMATION:
                quat = bins[:, 3:7].astype(np.float64)
                length = np.linalg.norm(quat, axis=1, keepdims=True)
                quat = np.where(length > 0, quat, [1.0, 0, 0, 0]) / np.maximum(length, 1)
                rotation[rows] = rotation_matrices(quat)
                triangles = IDENTITY + bins[:, 7:13] * steps["stretch"]
                stretch[rows] = unpack_symmetric(triangles)
            if group.color:
                rgb[rows] = bins[:, -3:] * steps["color"]
        shape = rotation @ stretch @ unpack_symmetric(self.rest_gaussians.root)
        cov = pack_symmetric(shape @ shape.transpose(0, 2, 1))
        return MotionFrame(present, x, cov, rotation, rgb)
