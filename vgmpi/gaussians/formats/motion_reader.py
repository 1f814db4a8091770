"""Reader of moving Gaussians: any frame of a page or stream that motion_writer.py made."""

import json
import struct
import zlib
from typing import NamedTuple

import numpy as np

from vgmpi.gaussians.cloud import pack_symmetric, rotation_matrices, unpack_symmetric
from vgmpi.gaussians.spherical_harmonics import rgb_from_dc

from .motion_layout import (
    DEFORMATION,
    FREE,
    IDENTITY,
    MAGIC,
    POSED,
    SIZE,
    VERSION,
    MotionGroup,
    RestGaussians,
)
from .residual_coding import CodedRows, inflate
from .validation import GaussianFileError


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
        rest: Gaussians at rest; positions of FREE groups are zero.
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
            self.rest = self._read_rest()
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
        x, present = self.rest.x.copy(), np.ones(n, bool)
        rotation = np.tile(np.eye(3), (n, 1, 1))
        stretch = np.tile(np.eye(3), (n, 1, 1))
        rgb = rgb_from_dc(self.rest.sh[:, 0])
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
        shape = rotation @ stretch @ unpack_symmetric(self.rest.root)
        cov = pack_symmetric(shape @ shape.transpose(0, 2, 1))
        return MotionFrame(present, x, cov, rotation, rgb)
