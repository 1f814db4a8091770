"""Cloud of 3D Gaussians with their colors, in plain NumPy, and the record of its file."""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from . import spherical_harmonics

OTHER_AXES = np.array([(1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2)])  # of a quaternion but one


@dataclass(frozen=True)
class CaptureRecord:
    """Facts about the file that a cloud was read from.

    Attributes:
        encoding: Format and version, such as ".spz, version 4".
        frame: Directions of x, y and z of the file, such as "RDF" (right, down, forward); empty
            if the file does not say. A reader returns the numbers as they are, and the registry
            turns the cloud to RDF.
        frame_source: Why this frame was taken, as a clause; empty if nothing was to be decided.
        render_model_source: Why the Gaussians count as antialiased or not, as a clause; empty if
            the file does not say.
        has_filter_3d: Whether sizes and opacities contain the 3D filter of the file.
        comments: Comments of the file that a user may want to see, such as its vertical axis.
        doubts: Doubts about the values, each one clause that names the columns.
        omissions: What the file holds and the reader left out, each one clause.
    """

    encoding: str
    frame: str = ""
    frame_source: str = ""
    render_model_source: str = ""
    has_filter_3d: bool = False
    comments: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    omissions: tuple[str, ...] = ()


@dataclass(frozen=True)
class GaussianCloud:
    """Set of n Gaussians, lengths in meters (before placement: in the units of its file).

    Attributes:
        x: Centers, shape (n, 3) float64.
        quat: Unit quaternions w, x, y, z, shape (n, 4) float64.
        scale: Standard deviations along the principal axes, shape (n, 3) float64.
        opacity: Opacities in 0..1, shape (n,) float64.
        sh: Color coefficients, shape (n, K, 3) float32, K = 1, 4, 9, 16.
        shade: Factors that a painted light has applied to the colors, shape (n,) float32, above 0
            and at most 1; None where there is none.
        is_antialiased: Whether the opacities are those of antialiased training: a renderer
            multiplies each by sqrt(det / det') for the variance that it adds in pixels.
        lowpass: Variance that the renderer of that training added [pixels^2]: 0.1 as Mip-Splatting
            and Brush, whose mark files carry, 0.3 as gsplat. It has no meaning for other clouds.
        labels: Integer columns of the file by name, each of shape (n,).
        record: What the reader learned of the file; None for clouds that were not read.
    """

    x: np.ndarray
    quat: np.ndarray
    scale: np.ndarray
    opacity: np.ndarray
    sh: np.ndarray
    shade: np.ndarray | None = None
    is_antialiased: bool = False
    lowpass: float = 0.1
    labels: dict[str, np.ndarray] = field(default_factory=dict)
    record: CaptureRecord | None = None

    def __post_init__(self):
        n = len(self.x)
        for name, shape in (("x", (n, 3)), ("quat", (n, 4)), ("scale", (n, 3)), ("opacity", (n,))):
            value = np.ascontiguousarray(getattr(self, name), dtype=np.float64)
            if value.shape != shape:
                raise ValueError(f"Cloud.{name} has shape {value.shape}, expected {shape}")
            object.__setattr__(self, name, value)
        coefficients = np.ascontiguousarray(self.sh, dtype=np.float32)
        allowed = [(n, k, 3) for k in spherical_harmonics.COEFFICIENTS]
        if coefficients.shape not in allowed:
            raise ValueError(f"Cloud.sh has shape {coefficients.shape}, expected one of {allowed}")
        object.__setattr__(self, "sh", coefficients)
        if self.shade is not None:
            shade = np.ascontiguousarray(self.shade, dtype=np.float32)
            if shade.shape != (n,):
                raise ValueError(f"Cloud.shade has shape {shade.shape}, expected {(n,)}")
            object.__setattr__(self, "shade", shade)
        for name, label in self.labels.items():
            if label.shape != (n,) or label.dtype.kind not in "iu":
                raise ValueError(f"Cloud.labels[{name!r}] is not a column of {n} integers")

    def __len__(self) -> int:
        return len(self.x)

    @property
    def rgb(self) -> np.ndarray:
        """Colors without their view dependence, in 0..1 (n, 3)."""
        return np.clip(spherical_harmonics.rgb_from_dc(self.sh[:, 0].astype(np.float64)), 0.0, 1.0)

    @property
    def shades(self) -> np.ndarray:
        """Factors `shade` (n,), 1 where no light was painted."""
        return np.ones(len(self), dtype=np.float32) if self.shade is None else self.shade

    def cov(self) -> np.ndarray:
        """Return the covariances as upper triangles xx, xy, xz, yy, yz, zz [length^2], (n, 6)."""
        root = rotation_matrices(self.quat) * self.scale[:, None, :]
        return pack_symmetric(root @ root.transpose(0, 2, 1))

    def select(self, mask: np.ndarray) -> "GaussianCloud":
        """Return the Gaussians of a boolean mask or an index array, in its order."""
        return replace(
            self,
            x=self.x[mask],
            quat=self.quat[mask],
            scale=self.scale[mask],
            opacity=self.opacity[mask],
            sh=self.sh[mask],
            shade=None if self.shade is None else self.shade[mask],
            labels={name: label[mask] for name, label in self.labels.items()},
        )

    def transformed(
        self, rotation: np.ndarray, scale: float = 1.0, shift: ArrayLike = (0.0, 0.0, 0.0)
    ) -> "GaussianCloud":
        """Return the cloud after x -> scale * rotation @ x + shift.

        Shapes and colors turn along.

        Args:
            rotation: Proper rotation matrix, shape (3, 3).
            scale: Linear factor > 0.
            shift: Displacement, shape (3,).

        Raises:
            ValueError: If the rotation is not proper.
        """
        rotation = np.asarray(rotation, dtype=np.float64)
        with np.errstate(invalid="ignore"):  # NaN is rejected as well
            proper = np.linalg.det(rotation) > 0
        if not proper or not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6):
            raise ValueError("a cloud can only be turned by a proper rotation matrix")
        quat = quaternion_product(quaternion(rotation), self.quat)
        return replace(
            self,
            x=scale * self.x @ rotation.T + np.asarray(shift, dtype=np.float64),
            quat=quat / np.linalg.norm(quat, axis=1, keepdims=True),
            scale=scale * self.scale,
            sh=spherical_harmonics.rotate(self.sh, rotation),
        )


def pack_symmetric(matrices: np.ndarray) -> np.ndarray:
    """Return the upper triangles (n, 6) of symmetric matrices (n, 3, 3)."""
    return matrices[:, (0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2)]


def unpack_symmetric(triangles: np.ndarray) -> np.ndarray:
    """Return the symmetric matrices (n, 3, 3) of upper triangles (n, 6)."""
    return triangles[:, (0, 1, 2, 1, 3, 4, 2, 4, 5)].reshape(-1, 3, 3)


def rotation_matrices(quat: np.ndarray) -> np.ndarray:
    """Return the rotation matrices (n, 3, 3) of unit quaternions w, x, y, z (n, 4)."""
    w, x, y, z = np.asarray(quat, dtype=np.float64).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """Return the unit quaternions w, x, y, z (..., 4) of rotation matrices (..., 3, 3).

    q q^T is linear in the matrix, so q is the eigenvector of its largest eigenvalue: there are no
    case distinctions, and half turns are safe.

    References:
        I. Y. Bar-Itzhack 2000.
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
    leading = np.take_along_axis(q, np.abs(q).argmax(axis=-1)[..., None], axis=-1)
    return np.where(leading > 0, q, -q)


def principal_axes(cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return unit quaternions (n, 4) and standard deviations (n, 3) of covariances (n, 6).

    Covariances are in [length^2]. This is the inverse of GaussianCloud.cov; eigenvalues that
    rounding left below zero become zero.
    """
    values, vectors = np.linalg.eigh(unpack_symmetric(np.asarray(cov, dtype=np.float64)))
    vectors[:, :, 0] *= np.where(np.linalg.det(vectors) < 0, -1.0, 1.0)[:, None]
    return quaternion(vectors), np.sqrt(np.maximum(values, 0.0))


def complete_quaternions(leading_axis: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return the unit quaternions w, x, y, z (n, 4) of which three components are known.

    Args:
        leading_axis: Number of the component that is left out and not negative, shape (n,).
        others: The other components in their order, shape (n, 3).
    """
    quat = np.empty((len(others), 4))
    np.put_along_axis(quat, OTHER_AXES[leading_axis], others, axis=1)
    leading = np.sqrt(np.maximum(0.0, 1 - (others**2).sum(axis=1)))
    np.put_along_axis(quat, leading_axis[:, None], leading[:, None], axis=1)
    return quat


def quaternion_product(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return the quaternions w, x, y, z (..., 4) of the rotations "first q, then p"."""
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
