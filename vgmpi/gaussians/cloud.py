"""A cloud of 3D Gaussians with its colours, in plain numpy."""

from dataclasses import dataclass

import numpy as np

from vgmpi.gaussians import sh as harmonics


@dataclass(frozen=True)
class Cloud:
    """n Gaussians, lengths in metres (until it is placed: in the units of its file).

    x: centres (n, 3) float64. quat: unit quaternions w, x, y, z (n, 4) float64. scale: standard
    deviations along the own axes (n, 3) float64. opacity: 0..1 (n,) float64. sh: colour
    coefficients (n, K, 3) float32, K = 1, 4, 9, 16. shade: what its colours were multiplied with
    by a painted light (n,) float32, above 0 and at most 1; None where there is none.
    """

    x: np.ndarray
    quat: np.ndarray
    scale: np.ndarray
    opacity: np.ndarray
    sh: np.ndarray
    shade: np.ndarray | None = None

    def __post_init__(self):
        n = len(self.x)
        for name, shape in (("x", (n, 3)), ("quat", (n, 4)), ("scale", (n, 3)), ("opacity", (n,))):
            value = np.ascontiguousarray(getattr(self, name), dtype=np.float64)
            if value.shape != shape:
                raise ValueError(f"Cloud.{name} has shape {value.shape}, expected {shape}")
            object.__setattr__(self, name, value)
        coefficients = np.ascontiguousarray(self.sh, dtype=np.float32)
        allowed = [(n, k, 3) for k in harmonics.COEFFICIENTS]
        if coefficients.shape not in allowed:
            raise ValueError(f"Cloud.sh has shape {coefficients.shape}, expected one of {allowed}")
        object.__setattr__(self, "sh", coefficients)
        if self.shade is not None:
            shade = np.ascontiguousarray(self.shade, dtype=np.float32)
            if shade.shape != (n,):
                raise ValueError(f"Cloud.shade has shape {shade.shape}, expected {(n,)}")
            object.__setattr__(self, "shade", shade)

    def __len__(self) -> int:
        return len(self.x)

    @property
    def rgb(self) -> np.ndarray:
        """Colours without their view dependence, in 0..1 (n, 3)."""
        return np.clip(harmonics.rgb_from_dc(self.sh[:, 0].astype(np.float64)), 0.0, 1.0)

    @property
    def shades(self) -> np.ndarray:
        """`shade` (n,), 1 where no light was painted."""
        return np.ones(len(self), dtype=np.float32) if self.shade is None else self.shade

    def cov(self) -> np.ndarray:
        """Covariances as upper triangles xx, xy, xz, yy, yz, zz [length^2], (n, 6)."""
        root = rotation_matrices(self.quat) * self.scale[:, None, :]
        return upper(root @ root.transpose(0, 2, 1))

    def select(self, mask: np.ndarray) -> "Cloud":
        """The Gaussians of a boolean mask or an index array, in its order."""
        return Cloud(
            self.x[mask],
            self.quat[mask],
            self.scale[mask],
            self.opacity[mask],
            self.sh[mask],
            None if self.shade is None else self.shade[mask],
        )

    def transformed(
        self, rotation: np.ndarray, scale: float = 1.0, shift: np.ndarray = (0.0, 0.0, 0.0)
    ) -> "Cloud":
        """The cloud after x -> scale * rotation @ x + shift; shapes and colours turn along.

        rotation: proper (3, 3). scale: linear factor > 0. shift: (3,).
        """
        rotation = np.asarray(rotation, dtype=np.float64)
        with np.errstate(invalid="ignore"):  # NaN is not proper either
            proper = np.linalg.det(rotation) > 0
        if not proper or not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6):
            raise ValueError("a cloud can only be turned by a proper rotation matrix")
        quat = quaternion_product(quaternion(rotation), self.quat)
        return Cloud(
            scale * self.x @ rotation.T + np.asarray(shift, dtype=np.float64),
            quat / np.linalg.norm(quat, axis=1, keepdims=True),
            scale * self.scale,
            self.opacity,
            harmonics.rotate(self.sh, rotation),
            self.shade,
        )


def upper(matrices: np.ndarray) -> np.ndarray:
    """Upper triangles (n, 6) of symmetric matrices (n, 3, 3)."""
    return matrices[:, (0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2)]


def full(triangles: np.ndarray) -> np.ndarray:
    """Symmetric matrices (n, 3, 3) of upper triangles (n, 6)."""
    return triangles[:, (0, 1, 2, 1, 3, 4, 2, 4, 5)].reshape(-1, 3, 3)


def rotation_matrices(quat: np.ndarray) -> np.ndarray:
    """Rotation matrices (n, 3, 3) of unit quaternions w, x, y, z (n, 4)."""
    w, x, y, z = np.asarray(quat, dtype=np.float64).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """Unit quaternions w, x, y, z (..., 4) of rotation matrices (..., 3, 3).

    q q^T is linear in the matrix (Bar-Itzhack 2000), so q is the eigenvector of its largest
    eigenvalue: no case distinctions, and safe at half turns.
    """
    rows = np.moveaxis(np.asarray(rotation, dtype=np.float64), (-2, -1), (0, 1))
    (a, b, c), (d, e, f), (g, h, i) = rows
    k = np.array(
        [
            [a + e + i, h - f, c - g, d - b],
            [h - f, a - e - i, b + d, c + g],
            [c - g, b + d, e - a - i, f + h],
            [d - b, c + g, f + h, i - a - e],
        ]
    )
    q = np.linalg.eigh(np.moveaxis(k, (0, 1), (-2, -1)))[1][..., -1]
    largest = np.take_along_axis(q, np.abs(q).argmax(axis=-1)[..., None], axis=-1)
    return np.where(largest > 0, q, -q)


def principal(cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit quaternions (n, 4) and standard deviations (n, 3) of covariances (n, 6) [length^2].

    The inverse of Cloud.cov; what rounding left below zero is zero.
    """
    values, vectors = np.linalg.eigh(full(np.asarray(cov, dtype=np.float64)))
    vectors[:, :, 0] *= np.where(np.linalg.det(vectors) < 0, -1.0, 1.0)[:, None]
    return quaternion(vectors), np.sqrt(np.maximum(values, 0.0))


def quaternion_product(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Quaternions of the rotations "first q, then p", both w, x, y, z (..., 4)."""
    pw, px, py, pz = np.moveaxis(np.asarray(p), -1, 0)
    qw, qx, qy, qz = np.moveaxis(np.asarray(q), -1, 0)
    return np.stack(
        [
            pw * qw - px * qx - py * qy - pz * qz,
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
        ],
        axis=-1,
    )
