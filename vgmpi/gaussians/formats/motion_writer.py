"""Writer of moving Gaussians in one stream of bytes, frame by frame."""

import json
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np

from .motion_layout import (
    DEFORMATION,
    FREE,
    IDENTITY,
    KEY_INTERVAL,
    MAGIC,
    SIZE,
    STEPS,
    VERSION,
    GroupState,
    MotionGroup,
    RestGaussians,
)
from .residual_coding import MAX_BIN, CodedRows, deflate
from .validation import GaussianFileError

HOLD = 1.0  # [steps] change of a shape or color below which the stored integer stays


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
        self.groups, self.rest, self.key_interval = list(groups), gaussians, key_interval
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
        gaussians = self.rest
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
