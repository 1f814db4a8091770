"""Lossless coding of integer arrays that change little from frame to frame.

Values are predicted from the frames before and from the rows before; the residuals are stored by
byte planes, which deflate compresses well. docs/reference/web-format.md describes the bytes.
"""

import zlib
from collections.abc import Iterable

import numpy as np

SEGMENT = 1024  # [rows] that share a predictor
HISTORY = 3  # [frames] that a predictor may use
MAX_BIN = 1 << 27  # bound of values: predictions stay within int32

# A predictor of mode m: m % 4 combines the last frames, m // 4 selects the rows before.
TEMPORAL = ((1, 0, 0), (2, -1, 0), (7, -2, -1), (3, -3, 1))  # factors of frames t-1, t-2, t-3
TEMPORAL_SHIFT = (0, 0, 2, 0)  # the sum is divided by 2^shift, rounded down
WINDOWS = (0, 1, 4)  # [rows] whose mean residual is subtracted; a window is a power of two
_WINDOW_SHIFT = (0, 0, 2)
STRATEGIES = (zlib.Z_FILTERED, zlib.Z_HUFFMAN_ONLY, zlib.Z_RLE)  # tried for each plane
_END = zlib.compressobj(6, zlib.DEFLATED, -zlib.MAX_WBITS).flush()  # an empty last block


class CodedRows:
    """Encoder and decoder of one array of integers (rows, channels) over the frames."""

    def __init__(self, rows: int, channels: int):
        self.rows, self.channels = rows, channels
        self.history = [np.zeros((channels, rows), np.int32)] * HISTORY

    def encode(self, bins: np.ndarray, is_key: bool) -> list[bytes]:
        """Return the bytes of the next frame in pieces of similar statistics.

        Args:
            bins: Values, shape (rows, channels), int32 within +-MAX_BIN.
            is_key: Whether the frame is decoded without the frames before it.
        """
        values = np.ascontiguousarray(bins.T, dtype=np.int32)
        self._begin(is_key)
        coded = [self._encode_channel(c, values[c], is_key) for c in range(self.channels)]
        self._end(values, is_key)
        return [piece for pieces in coded for piece in pieces]

    def decode(self, data: memoryview, position: int, is_key: bool) -> tuple[np.ndarray, int]:
        """Return the values (rows, channels) of the next frame and the position behind them."""
        self._begin(is_key)
        values = np.empty((self.channels, self.rows), np.int32)
        for c in range(self.channels):
            position = self._decode_channel(c, values[c], data, position)
        self._end(values, is_key)
        return values.T, position

    def _begin(self, is_key: bool) -> None:
        """Reset the history before a key frame."""
        if is_key:
            self.history = [np.zeros((self.channels, self.rows), np.int32)] * HISTORY

    def _end(self, values: np.ndarray, is_key: bool) -> None:
        """Append a frame to the history; a key frame fills it."""
        self.history = [values] * HISTORY if is_key else [values, *self.history[:-1]]

    def _temporal(self, channel: int, predictor: int) -> np.ndarray:
        """Return the prediction of a channel by the frames before."""
        frames = [h[channel] for h in self.history]
        total = sum(k * h for k, h in zip(TEMPORAL[predictor], frames) if k)
        return np.asarray(total, np.int32) >> TEMPORAL_SHIFT[predictor]

    def _encode_channel(self, channel: int, values: np.ndarray, is_key: bool) -> list[bytes]:
        """Return modes and byte planes of one channel."""
        segments = -(-self.rows // SEGMENT)
        smallest = np.full(segments, np.inf, np.float32)
        modes = np.zeros(segments, np.uint8)
        best = np.zeros((segments, SEGMENT), np.int32)
        for predictor in range(1 if is_key else len(TEMPORAL)):
            residual = _segments(values - self._temporal(channel, predictor))
            for window in range(len(WINDOWS)):
                candidate = residual - _mean_before(residual, window)
                size = np.log2(1 + np.abs(candidate)).sum(axis=1, dtype=np.float32)
                is_better = size < smallest
                smallest[is_better] = size[is_better]
                best[is_better] = candidate[is_better]
                modes[is_better] = predictor + 4 * window
        flat = best.reshape(-1)[: self.rows]
        zigzag = ((flat << 1) ^ (flat >> 31)).astype(np.uint32)
        planes = (int(zigzag.max(initial=0)).bit_length() + 7) // 8
        rows = [(zigzag >> (8 * k)).astype(np.uint8).tobytes() for k in range(planes)]
        return [modes.tobytes() + bytes([planes]), *rows]

    def _decode_channel(
        self, channel: int, out: np.ndarray, data: memoryview, position: int
    ) -> int:
        """Decode one channel into `out` (rows,) and return the position behind it."""
        segments = -(-self.rows // SEGMENT)
        modes = np.frombuffer(data, np.uint8, segments, position)
        planes = data[position + segments]
        position += segments + 1
        zigzag = np.zeros(self.rows, np.uint32)
        for k in range(planes):
            plane = np.frombuffer(data, np.uint8, self.rows, position)
            zigzag |= plane.astype(np.uint32) << np.uint32(8 * k)
            position += self.rows
        residual = _segments((zigzag >> 1).astype(np.int32) ^ -(zigzag & 1).astype(np.int32))
        for window in range(1, len(WINDOWS)):
            selected = np.flatnonzero(modes // 4 == window)
            residual[selected] = _integrated(residual[selected], window)
        prediction = np.empty_like(residual)
        for predictor in np.unique(modes % 4):
            selected = modes % 4 == predictor
            prediction[selected] = _segments(self._temporal(channel, int(predictor)))[selected]
        out[:] = (prediction + residual).reshape(-1)[: self.rows]
        return position


def _segments(values: np.ndarray) -> np.ndarray:
    """Return the rows by segments (segments, SEGMENT), filled with zeros."""
    segments = -(-len(values) // SEGMENT)
    out = np.zeros(segments * SEGMENT, np.int32)
    out[: len(values)] = values
    return out.reshape(segments, SEGMENT)


def _mean_before(residual: np.ndarray, window: int) -> np.ndarray | int:
    """Return the mean of the residuals before each, rounded down; those before a segment are 0."""
    if WINDOWS[window] == 0:
        return 0
    total = np.zeros_like(residual)
    for shift in range(1, WINDOWS[window] + 1):
        total[:, shift:] += residual[:, :-shift]
    return total >> _WINDOW_SHIFT[window]


def _integrated(coded: np.ndarray, window: int) -> np.ndarray:
    """Return the residuals (segments, SEGMENT) whose difference to `_mean_before` is `coded`."""
    if WINDOWS[window] == 1:
        return np.cumsum(coded, axis=1, dtype=np.int32)
    out = np.zeros((SEGMENT + WINDOWS[window], len(coded)), np.int32)
    columns = np.ascontiguousarray(coded.T)
    shift = WINDOWS[window]
    for row in range(SEGMENT):
        before = out[row : row + shift].sum(axis=0, dtype=np.int32)
        out[row + shift] = columns[row] + (before >> _WINDOW_SHIFT[window])
    return out[shift:].T


def deflate(pieces: Iterable[bytes]) -> bytes:
    """Return one raw deflate stream of the pieces, each compressed by the strategy that suits it.

    A piece ends with an empty stored block on a byte boundary, so that the streams join.
    """
    streams = [
        min((_deflate_piece(piece, strategy) for strategy in STRATEGIES), key=len)
        for piece in pieces
        if piece
    ]
    return b"".join([*streams, _END])


def _deflate_piece(piece: bytes, strategy: int) -> bytes:
    """Return deflate blocks of a piece that end on a byte boundary."""
    compressor = zlib.compressobj(6, zlib.DEFLATED, -zlib.MAX_WBITS, 8, strategy)
    return compressor.compress(piece) + compressor.flush(zlib.Z_SYNC_FLUSH)


def inflate(data: bytes) -> bytes:
    """Return the content of a raw deflate stream. Raises zlib.error."""
    return zlib.decompress(data, -zlib.MAX_WBITS)


def morton_order(x: np.ndarray, spacing: float) -> np.ndarray:
    """Return the order (n,) of points (n, 3) along a Morton curve with cells of `spacing`."""
    if not len(x):
        return np.zeros(0, np.int64)
    lattice = np.clip((x - x.min(axis=0)) / spacing, 0, (1 << 20) - 1).astype(np.uint64)
    return np.argsort(morton_keys(lattice, 20), kind="stable")


def morton_keys(cells: np.ndarray, bits: int) -> np.ndarray:
    """Return the Morton keys (n,) uint64 of cells (n, 3) uint64 of `bits` bits along each axis."""
    keys = np.zeros(len(cells), np.uint64)
    for bit in range(bits):
        for axis in range(3):
            digit = (cells[:, axis] >> np.uint64(bit)) & np.uint64(1)
            keys |= digit << np.uint64(3 * bit + axis)
    return keys
