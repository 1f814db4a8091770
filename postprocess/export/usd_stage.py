"""OpenUSD file of a run: particle fields of 3D Gaussian splats with time samples.

The schema ParticleField3DGaussianSplat is part of OpenUSD since 26.03. A time code is a frame of
the run; the stage has meters and z up. It needs usd-core: pip install "vgmpi[usd]".
"""

import itertools
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vgmpi.gaussians import spherical_harmonics
from vgmpi.gaussians.camera import Camera
from vgmpi.gaussians.cloud import quaternion, rotation_matrices, unpack_symmetric
from vgmpi.gaussians.formats import motion_stream
from vgmpi.gaussians.formats.motion_stream import GroupState, MotionGroup, RestGaussians
from vgmpi.io.run_reader import RunError

APERTURE = 0.36  # [tenths of a meter] horizontal aperture of the cameras, 36 mm
SAVE_INTERVAL = 16  # [frames] after which samples go to the disk
EXTENT = 3.0  # [standard deviations] of a Gaussian within the extent of a prim
SUFFIXES = (".usdc", ".usda", ".usd", ".usdz")


def load_usd() -> Any:
    """Return the module pxr. Raises RunError if it is not installed."""
    try:
        import pxr
        from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdUtils, UsdVol, Vt  # noqa: F401
    except ImportError:
        raise RunError("not installed: pip install 'vgmpi[usd]'") from None
    if not hasattr(UsdVol, "ParticleField3DGaussianSplat"):
        raise RunError("usd-core is older than 26.3: pip install 'vgmpi[usd]'")
    return pxr


class AxesTracker:
    """Principal axes of Gaussians that change as little as possible from frame to frame.

    A viewer interpolates rotations and sizes between frames; eigenvectors alone change their order
    and signs.
    """

    def __init__(self) -> None:
        self.axes: np.ndarray | None = None
        self.quat: np.ndarray | None = None

    def advance(self, cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return rotations (n, 4) and standard deviations (n, 3) of the next covariances.

        cov: shape (n, 3, 3) [m2].
        """
        values, vectors = np.linalg.eigh(cov)
        if self.axes is not None:
            overlap = np.abs(self.axes.transpose(0, 2, 1) @ vectors)
            orders = np.array(list(itertools.permutations(range(3))))
            fit = np.stack([overlap[:, range(3), order].sum(axis=1) for order in orders], axis=1)
            order = orders[fit.argmax(axis=1)]
            values = np.take_along_axis(values, order, axis=1)
            vectors = np.take_along_axis(vectors, order[:, None, :], axis=2)
            sign = np.einsum("nij,nij->nj", self.axes, vectors) < 0
            vectors = np.where(sign[:, None, :], -vectors, vectors)
        vectors[np.linalg.det(vectors) < 0, :, 0] *= -1
        quat = quaternion(vectors)
        if self.quat is not None:
            quat = np.where((quat * self.quat).sum(axis=1, keepdims=True) < 0, -quat, quat)
        self.axes, self.quat = vectors, quat
        return quat, np.sqrt(np.maximum(values, 0.0))


class _GroupPrim:
    """Prim of one group and what its time samples need."""

    def __init__(self, prim: Any, rows: slice, group: MotionGroup):
        self.prim, self.rows, self.group = prim, rows, group
        self.tracker = AxesTracker()
        self.last: GroupState | None = None
        self.x = np.zeros((group.count, 3))
        self.cov: np.ndarray | None = None
        self.was_complete = True


class UsdStage:
    """Writer of one stage, frame by frame. Raises RunError if usd-core is not installed."""

    def __init__(
        self,
        path: Path,
        groups: Sequence[MotionGroup],
        gaussians: RestGaussians,
        *,
        frames: int,
        rate: float,
    ):
        """Create the stage and what does not move.

        Args:
            path: File, .usdc, .usda or .usd.
            groups: Groups in the order of `gaussians`.
            gaussians: Gaussians at rest.
            frames: Number of frames.
            rate: Frames per second of the playback.
        """
        self.usd, self.rest_gaussians = load_usd(), gaussians
        usd = self.usd
        self.stage = usd.Usd.Stage.CreateNew(str(path))
        usd.UsdGeom.SetStageUpAxis(self.stage, usd.UsdGeom.Tokens.z)
        usd.UsdGeom.SetStageMetersPerUnit(self.stage, 1.0)
        self.stage.SetTimeCodesPerSecond(rate)
        self.stage.SetFramesPerSecond(rate)
        self.stage.SetStartTimeCode(0.0)
        self.stage.SetEndTimeCode(float(frames - 1))
        world = usd.UsdGeom.Xform.Define(self.stage, "/World").GetPrim()
        self.stage.SetDefaultPrim(world)
        starts = np.cumsum([0, *(group.count for group in groups)])
        self.prims = [
            self._add_group(group, slice(int(starts[k]), int(starts[k + 1])))
            for k, group in enumerate(groups)
        ]
        self.frame_count = 0

    def _path(self, name: str) -> str:
        """Return an unused path of a prim."""
        base = "/World/" + (re.sub(r"\W", "_", name, flags=re.ASCII) or "part")
        base = re.sub(r"/(\d)", r"/_\1", base)
        path, number = base, 1
        while self.stage.GetPrimAtPath(path):
            number += 1
            path = f"{base}_{number}"
        return path

    def _add_group(self, group: MotionGroup, rows: slice) -> _GroupPrim:
        """Return the prim of a group with its values at rest."""
        usd, gaussians = self.usd, self.rest_gaussians
        path = self._path(group.name)
        prim = usd.UsdVol.ParticleField3DGaussianSplat.Define(self.stage, path)
        entry = _GroupPrim(prim, rows, group)
        sh = gaussians.sh[rows]
        degree = round(sh.shape[1] ** 0.5) - 1
        prim.CreateRadianceSphericalHarmonicsDegreeAttr(degree)
        self._set_colors(entry, sh)
        prim.CreateOpacitiesAttr(_floats(usd, gaussians.opacity[rows]))
        root = unpack_symmetric(gaussians.root[rows])
        entry.cov = root @ root
        quat, scale = entry.tracker.advance(entry.cov)
        self._set_shapes(entry, quat, scale)
        if group.motion != motion_stream.FREE:
            self._set_positions(entry, gaussians.x[rows], scale)
        return entry

    def _set_colors(self, entry: _GroupPrim, sh: np.ndarray, *time: float) -> None:
        """Set the color coefficients (n, K, 3)."""
        values = self.usd.Vt.Vec3fArray.FromNumpy(_single(sh.reshape(-1, 3)))
        entry.prim.CreateRadianceSphericalHarmonicsCoefficientsAttr().Set(values, *time)

    def _set_shapes(
        self, entry: _GroupPrim, quat: np.ndarray, scale: np.ndarray, *time: float
    ) -> None:
        """Set rotations and standard deviations; numpy has quaternions as x, y, z, w here."""
        usd = self.usd
        turned = usd.Vt.QuatfArray.FromNumpy(_single(quat[:, (1, 2, 3, 0)]))
        entry.prim.CreateOrientationsAttr().Set(turned, *time)
        entry.prim.CreateScalesAttr().Set(usd.Vt.Vec3fArray.FromNumpy(_single(scale)), *time)

    def _set_positions(
        self, entry: _GroupPrim, x: np.ndarray, scale: np.ndarray, *time: float
    ) -> None:
        """Set centers and the extent."""
        array = self.usd.Vt.Vec3fArray
        entry.prim.CreatePositionsAttr().Set(array.FromNumpy(_single(x)), *time)
        margin = EXTENT * scale.max(axis=1, keepdims=True)
        extent = np.stack([(x - margin).min(axis=0), (x + margin).max(axis=0)])
        entry.prim.CreateExtentAttr().Set(array.FromNumpy(_single(extent)), *time)

    def add_frame(
        self, states: Sequence[GroupState], poses: Sequence[np.ndarray], cameras: dict[str, Camera]
    ) -> None:
        """Write the time samples of the next frame.

        Args:
            states: State of each FREE group.
            poses: Rigid poses (4, 4) of the POSED groups.
            cameras: Cameras by name.
        """
        time = float(self.frame_count)
        entries = iter(states)
        for entry in self.prims:
            if entry.group.motion == motion_stream.POSED:
                self._set_pose(entry.prim, poses[entry.group.pose], time)
            if entry.group.motion == motion_stream.FREE:
                self._add_state(entry, next(entries), time)
        for name, camera in cameras.items():
            self._set_camera(name, camera, time)
        self.frame_count += 1
        if self.frame_count % SAVE_INTERVAL == 0:
            self.stage.GetRootLayer().Save()

    def _set_pose(self, prim: Any, pose: np.ndarray, time: float) -> None:
        """Set the transform of a prim; USD multiplies rows from the left."""
        ops = prim.GetOrderedXformOps()
        op = ops[0] if ops else prim.AddTransformOp()
        matrix = np.asarray(pose, dtype=np.float64).T
        op.Set(self.usd.Gf.Matrix4d(*matrix.ravel().tolist()), time)

    def _add_state(self, entry: _GroupPrim, state: GroupState, time: float) -> None:
        """Write the samples of a FREE group."""
        present, gaussians = state.present, self.rest_gaussians
        entry.x[present] = state.x
        assert entry.cov is not None and entry.tracker.quat is not None
        quat = entry.tracker.quat
        root = unpack_symmetric(gaussians.root[entry.rows])[present]
        if entry.group.shape == motion_stream.SIZE:
            assert state.size is not None
            entry.cov[present] = root @ root * (state.size**2)[:, None, None]
        rotation = None
        if entry.group.shape == motion_stream.DEFORMATION:
            assert state.quat is not None and state.stretch is not None
            rotation = rotation_matrices(state.quat)
            shape = rotation @ unpack_symmetric(state.stretch) @ root
            entry.cov[present] = shape @ shape.transpose(0, 2, 1)
            quat, scale = entry.tracker.advance(entry.cov)
        else:  # the axes stay
            axes = rotation_matrices(quat)
            values = np.einsum("nij,nik,nkj->nj", axes, entry.cov, axes)
            scale = np.sqrt(np.maximum(values, 0.0))
        if entry.group.shape == motion_stream.DEFORMATION:
            self._set_shapes(entry, quat, scale, time)
        elif entry.group.shape == motion_stream.SIZE:
            sizes = self.usd.Vt.Vec3fArray.FromNumpy(_single(scale))
            entry.prim.GetScalesAttr().Set(sizes, time)
        self._set_positions(entry, entry.x, scale, time)
        self._set_changing_colors(entry, state, rotation, time)
        self._set_presence(entry, present, time)

    def _set_changing_colors(
        self, entry: _GroupPrim, state: GroupState, rotation: np.ndarray | None, time: float
    ) -> None:
        """Write colors that turn with a body or are stored in the frames."""
        sh = self.rest_gaussians.sh[entry.rows]
        if rotation is not None and not (sh[:, 1:] != 0).any():
            rotation = None
        if rotation is None and state.color is None:
            return
        sh = sh.copy()
        if rotation is not None:
            sh[state.present] = spherical_harmonics.rotate(sh[state.present], rotation)
        if state.color is not None:
            sh[state.present, 0] = spherical_harmonics.dc_from_rgb(state.color)
        self._set_colors(entry, sh, time)

    def _set_presence(self, entry: _GroupPrim, present: np.ndarray, time: float) -> None:
        """Write the opacities from the first frame on in which a Gaussian is absent."""
        opacity = self.rest_gaussians.opacity[entry.rows]
        attribute = entry.prim.GetOpacitiesAttr()
        if present.all() and entry.was_complete:
            return
        if entry.was_complete and time > 0:
            attribute.Set(_floats(self.usd, opacity), time - 1)
        entry.was_complete = False
        attribute.Set(_floats(self.usd, np.where(present, opacity, 0.0)), time)

    def _set_camera(self, name: str, camera: Camera, time: float) -> None:
        """Write the sample of a camera: USD looks along -z, with y up."""
        usd, path = self.usd, "/World/" + re.sub(r"\W", "_", "camera_" + name, flags=re.ASCII)
        prim = usd.UsdGeom.Camera.Get(self.stage, path)
        if not prim:
            prim = usd.UsdGeom.Camera.Define(self.stage, path)
            height = APERTURE * camera.height / camera.width * camera.fx / camera.fy
            prim.CreateHorizontalApertureAttr(APERTURE)
            prim.CreateVerticalApertureAttr(height)
            offset = APERTURE * (0.5 - camera.cx / camera.width)
            prim.CreateHorizontalApertureOffsetAttr(offset)
            prim.CreateVerticalApertureOffsetAttr(height * (camera.cy / camera.height - 0.5))
            prim.CreateClippingRangeAttr(usd.Gf.Vec2f(camera.near_plane, 1e4))
        prim.CreateFocalLengthAttr().Set(APERTURE * camera.fx / camera.width, time)
        pose = np.eye(4)
        pose[:3, :3] = camera.world_to_camera[:3, :3].T * [1, -1, -1]
        pose[:3, 3] = camera.eye
        self._set_pose(prim, pose, time)

    def add_light(self, direction: Sequence[float]) -> None:
        """Add a distant light that travels along `direction` (3,)."""
        usd = self.usd
        light = usd.UsdLux.DistantLight.Define(self.stage, "/World/light")
        light.CreateIntensityAttr(1.0)
        rotation = usd.Gf.Rotation(usd.Gf.Vec3d(0, 0, -1), usd.Gf.Vec3d(*map(float, direction)))
        light.AddTransformOp().Set(usd.Gf.Matrix4d().SetRotate(rotation))

    def add_mesh(
        self, name: str, points: np.ndarray, faces: Sequence[Sequence[int]], color: Sequence[float]
    ) -> Any:
        """Add a mesh and return its prim.

        Args:
            name: Name of the object.
            points: Vertices, shape (m, 3) [m].
            faces: Vertices of each face, counterclockwise from outside.
            color: Color in 0..1, shape (3,).
        """
        usd = self.usd
        mesh = usd.UsdGeom.Mesh.Define(self.stage, self._path(name + "_surface"))
        array = usd.Vt.Vec3fArray
        mesh.CreatePointsAttr(array.FromNumpy(_single(points)))
        mesh.CreateFaceVertexCountsAttr([len(face) for face in faces])
        mesh.CreateFaceVertexIndicesAttr([vertex for face in faces for vertex in face])
        mesh.CreateSubdivisionSchemeAttr(usd.UsdGeom.Tokens.none)
        extent = np.stack([points.min(axis=0), points.max(axis=0)])
        mesh.CreateExtentAttr(array.FromNumpy(_single(extent)))
        mesh.CreateDisplayColorAttr([usd.Gf.Vec3f(*map(float, color))])
        return mesh

    def set_mesh_pose(self, mesh: Any, pose: np.ndarray) -> None:
        """Write the pose (4, 4) of a mesh in the frame that was added last."""
        self._set_pose(mesh, pose, float(self.frame_count - 1))

    def save(self) -> None:
        """Write what is not on the disk yet."""
        self.stage.GetRootLayer().Save()


def _single(values: np.ndarray) -> np.ndarray:
    """Return values as a contiguous float32 array."""
    return np.ascontiguousarray(values, dtype=np.float32)


def _floats(usd: Any, values: np.ndarray) -> Any:
    """Return values (n,) as an array of USD."""
    return usd.Vt.FloatArray.FromNumpy(_single(values))
