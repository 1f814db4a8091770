"""Appearance of a run at a frame: Gaussians to draw from rest Gaussians and moving particles."""

import logging

import numpy as np

from vgmpi.gaussians import compiled_evolution, shape_evolution
from vgmpi.gaussians.capture_conventions import COMPENSATED_LOWPASS
from vgmpi.io.run_reader import RunError
from vgmpi.runtime.message_text import did_you_mean

from ..raster.rasterize import ALPHA_MIN, ProjectableGaussians, join_gaussians
from .frame_colors import FrameColors
from .frame_gaussians import (
    DEFORMED,
    FIXED,
    RADIUS_SPHERE,
    SCALED,
    VOLUME_SPHERE,
    GaussianBatch,
    Passive,
    Scenery,
    ViewColors,
    moving,
    select_rows,
)
from .render_config import LookSettings, SettingsError

log = logging.getLogger("vgmpi")

FAINT_OPACITY = 0.02  # [-] below this opacity of fluids a cut at 1/255 removes a quarter or more
ALPHA_MIN_FAINT = 1e-4


class Appearance:
    """Quantities of a run's appearance that do not change from frame to frame.

    run: vgmpi.io.run_reader.RunReader, or anything with the same `objects` and `gaussians`.
    chosen: the table [look] of render.toml. Raises SettingsError.
    """

    def __init__(self, run, chosen: LookSettings | None = None):
        chosen = chosen or LookSettings()
        gaussians = run.gaussians
        self.run = run
        self.objects = run.objects
        self.object = np.asarray(gaussians.object)
        fluid = np.array([o.get("family") == "fluid" for o in self.objects] or [False])
        rules = np.array([_shape_rule(o, chosen) for o in self.objects] or [FIXED])
        turns = np.array([_rotates_color(o, chosen) for o in self.objects] or [False])
        factor = np.array(_opacity_scales(self.objects, chosen) or [1.0])
        self.fluid = fluid[self.object]
        self.rule = rules[self.object]
        self.turns = turns[self.object]
        self.opacity = np.asarray(gaussians.opacity, dtype=np.float64) * factor[self.object]
        self.shade = getattr(gaussians, "shade", None)  # shading that the colors contain
        self.opacity_scales = np.array(
            [chosen.opacity_scale.get(str(o.get("name")), np.nan) for o in self.objects] or [np.nan]
        )
        self.vol0 = np.asarray(gaussians.vol0, dtype=np.float64)
        self.cov0 = np.asarray(gaussians.cov0, dtype=np.float64)
        self.spacing = float(np.cbrt(np.median(self.vol0))) if len(self.vol0) else 1.0
        self.brightness_jitter = _brightness_jitter(self.objects, chosen)
        self.color = ViewColors(np.asarray(gaussians.sh))
        self.colors = FrameColors(run, chosen)
        own = _compensated_lowpass(self.objects)
        self.compensated_lowpass = select_rows(own, self.object)
        self.scenery = None
        scenery = getattr(gaussians, "scenery", None)
        if scenery is not None and len(scenery.x0):
            self.scenery = Scenery(scenery, self.objects, factor, own)
        self.passive = None
        if getattr(gaussians, "passive", None) is not None:
            self.passive = Passive(gaussians, rules, turns, factor, own)

    def cell_size(self) -> float:
        """Return the edge of a grid cell [m]; the particles' distance if the scene has no cell."""
        scene = getattr(self.run, "scene", {})
        try:
            cell = float(scene["domain"]["cell"])
        except (KeyError, TypeError, ValueError):
            return self.spacing
        return cell if 0 < cell < np.inf else self.spacing

    def frame(self, index: int) -> dict[str, np.ndarray]:
        """Read frame `index`; add its colors as "sh" (n, K, 3) if colors are transferred."""
        frame = self.run.frame(index)
        self.check(frame, f"frame {index}")
        sh = self.colors.at_frame(index, frame)
        return frame if sh is None else {**frame, "sh": sh}

    def check(self, frame: dict[str, np.ndarray], name: str = "a frame") -> None:
        """Raise RunError if a frame does not belong to the run, or cannot be drawn."""
        rows = np.asarray(frame["id"])
        if len(rows) and not 0 <= rows.min() <= rows.max() < len(self.object):
            raise RunError(f"{name} holds particles that gaussians.h5 does not know")
        for field in ("positions", "F", "J"):
            if field in frame and not np.isfinite(frame[field]).all():
                raise RunError(f"{name} holds {field} that are not finite")
        if self.scenery is not None and len(frame.get("poses", ())) != len(moving(self.objects)):
            raise RunError(f"{name} does not say where each object is that moves")

    def splats(self, frame: dict[str, np.ndarray], eye: np.ndarray) -> ProjectableGaussians:
        """Return the Gaussians of a frame as seen from `eye` [m]; scenery comes first.

        frame: arrays id, x, and J (all but elastic bodies), F (elastic bodies) as in the file; and
        sh if the colors differ from those at rest (see `frame`). Raises RunError.
        """
        self.check(frame)
        return view_dependent_splats(self.parts(frame), eye)

    def parts(self, frame: dict[str, np.ndarray]) -> list[GaussianBatch]:
        """Return the Gaussians of a frame for any view. Raises RunError."""
        rows = np.asarray(frame["id"])
        x = np.asarray(frame["positions"], dtype=np.float64)
        cov = self._covariances(rows, frame)
        color, color_rows = self.color, rows
        if "sh" in frame:
            color, color_rows = ViewColors(np.asarray(frame["sh"])), np.arange(len(rows))
        turning = np.flatnonzero(self.turns[rows] & color.view_dependent[color_rows])
        F = _deformation(frame)[turning] if len(turning) else None
        own = select_rows(self.compensated_lowpass, rows)
        parts = [
            GaussianBatch(
                x, cov, self.opacity[rows], color, color_rows, turning, F, compensated_lowpass=own
            )
        ]
        if self.brightness_jitter is not None:
            jitter = self.brightness_jitter[self.object[rows]] * _random(rows)
            parts[0] = parts[0].scaled_brightness(1 + jitter)
        if self.passive is not None:
            parts.append(self.passive.part(frame))
        if self.scenery is not None:
            parts.insert(0, self.scenery.part(frame))
        return parts

    def _covariances(self, rows: np.ndarray, frame: dict[str, np.ndarray]) -> np.ndarray:
        """Return the covariances [m2], (n, 6), by the shape rule of each row's body."""
        J = np.asarray(frame["J"]) if "J" in frame else np.ones(len(rows))
        cov = self.cov0[rows]
        rows_of_rule = {
            rule: np.flatnonzero(self.rule[rows] == rule)
            for rule in (DEFORMED, SCALED, VOLUME_SPHERE)
        }
        if len(selected := rows_of_rule[DEFORMED]):
            compiled_evolution.solid(self.cov0, rows, selected, _deformation(frame), cov)
        if len(selected := rows_of_rule[SCALED]):
            cov[selected] = shape_evolution.deformed_covariance(
                cov[selected], shape_evolution.isotropic_deformation(J[selected])
            )
        if len(selected := rows_of_rule[VOLUME_SPHERE]):
            cov[selected] = shape_evolution.volume_sphere_covariance(
                self.vol0[rows[selected]], J[selected]
            )
        if len(selected := np.flatnonzero(self.rule[rows] == RADIUS_SPHERE)):
            cov[selected] = shape_evolution.equivalent_sphere_covariance(cov[selected], J[selected])
        return cov

    def alpha_min(self, requested: float | None, surface: bool = False) -> float:
        """Return the alpha below which a Gaussian is left out of a pixel.

        Logs a value other than 1/255, and warns of objects that become invisible.

        Args:
            requested: Value from render.toml, or None for one that suits the run.
            surface: Whether fluids are drawn with a surface instead of Gaussians.
        """
        alpha_min = requested
        if alpha_min is None:
            # a scene gives every object a value, by default 1/255
            alpha_min = min([o["alpha_min"] for o in self.objects if o.get("alpha_min")] or [1.0])
            alpha_min = ALPHA_MIN if alpha_min == 1.0 else alpha_min
            fluid = self.opacity[self.fluid & (self.opacity > 0) & (not surface)]
            faint = len(fluid) > 0 and np.median(fluid) <= FAINT_OPACITY
            if faint and np.isclose(alpha_min, ALPHA_MIN):
                alpha_min = ALPHA_MIN_FAINT
            if alpha_min < 0.999 * ALPHA_MIN:
                opacities = "an object's alpha_min, or its opacity_scale below 0.1"
                reason = "the fluid is faint" if faint else opacities
                message = "faint Gaussians are drawn too, down to alpha_min = %g (usual: 1/255): %s"
                log.debug(message, alpha_min, reason)
        # others carry mass only
        is_drawn = np.asarray(self.run.gaussians.opacity) > 0
        for number, entry in enumerate(self.objects):
            if surface and entry.get("family") == "fluid":
                continue
            opacities = self.opacity[(self.object == number) & is_drawn]
            lost_count = np.count_nonzero(opacities < alpha_min)
            if lost_count and lost_count > 0.05 * len(opacities):
                log.warning(
                    "%d of %d Gaussians of '%s' are fainter than alpha_min = %g and vanish: "
                    "lower alpha_min or raise opacity_scale",
                    lost_count,
                    len(opacities),
                    entry.get("name", number),
                    alpha_min,
                )
        return alpha_min


def view_dependent_splats(parts: list[GaussianBatch], eye: np.ndarray) -> ProjectableGaussians:
    """Join the parts of a frame into the Gaussians as seen from `eye` [m]."""
    return join_gaussians([part.view_from(eye) for part in parts])


def _compensated_lowpass(objects: list[dict]) -> np.ndarray | None:
    """Return the compensated variance of each object [pixels^2], None if all are classic."""
    models = [entry.get("render_model", "classic") for entry in objects]
    if all(model == "classic" for model in models):
        return None
    return np.array([COMPENSATED_LOWPASS[model] for model in models])


def _brightness_jitter(objects: list[dict], chosen: LookSettings) -> np.ndarray | None:
    """Return the relative brightness variation of particles, by object, (objects,)."""
    if not chosen.brightness_jitter:
        return None
    names = [str(entry.get("name")) for entry in objects]
    _check_names("look.brightness_jitter", chosen.brightness_jitter, names)
    return np.array([chosen.brightness_jitter.get(name, 0.0) for name in names])


def _random(rows: np.ndarray) -> np.ndarray:
    """Return a fixed number in -1..1 for each row (S. Vigna's splitmix64)."""
    bits = (rows.astype(np.uint64) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return (bits >> np.uint64(11)).astype(np.float64) * 2.0**-52 - 1.0


def _check_names(key: str, table: dict, names: list[str]) -> None:
    """Raise SettingsError if a key of `table` is no object's name."""
    for name in table:
        if name not in names:
            suggestion = did_you_mean(name, names)
            text = f"there is no object '{name}'{suggestion}; known: {', '.join(names)}"
            raise SettingsError([f"{key}: {text}"])


def _deformation(frame: dict[str, np.ndarray]) -> np.ndarray:
    """Return F of a frame. Raises RunError."""
    if "F" not in frame:
        raise RunError("a frame with solids lacks the field F: they cannot be drawn")
    return np.asarray(frame["F"])


def _has_total_deformation(entry: dict) -> bool:
    """Return whether F in the frames is the deformation of the object's particles."""
    return bool(entry.get("tracks_deformation", entry.get("family") == "solid"))


def _shape_rule(entry: dict, chosen: LookSettings) -> int:
    """Return the shape rule of an object."""
    if chosen.covariance == "fixed":
        return FIXED
    deformation_rule = DEFORMED if _has_total_deformation(entry) else SCALED
    if entry.get("family") not in shape_evolution.FAMILIES_DRAWN_AS_SPHERES:
        return deformation_rule
    default = "none" if _has_total_deformation(entry) else "volume"
    return {"volume": VOLUME_SPHERE, "radius": RADIUS_SPHERE, "none": deformation_rule}[
        chosen.covariance_normalization or default
    ]


def _rotates_color(entry: dict, chosen: LookSettings) -> bool:
    """Return whether the colors of an object turn with the rotation in F."""
    follows_deformation = (
        _shape_rule(entry, chosen) == DEFORMED
        or entry.get("family") not in shape_evolution.FAMILIES_DRAWN_AS_SPHERES
    )
    return chosen.rotate_sh and _has_total_deformation(entry) and follows_deformation


def _opacity_scales(objects: list[dict], chosen: LookSettings) -> list[float]:
    """Return the factor on the opacities of each object; fluids are drawn thinner."""
    names = [str(entry.get("name")) for entry in objects]
    _check_names("look.opacity_scale", chosen.opacity_scale, names)
    if chosen.opacity == "fixed":
        return [1.0] * len(objects)
    scales = []
    for name, entry in zip(names, objects):
        scale = entry.get("opacity_scale") if entry.get("family") == "fluid" else None
        scale = chosen.opacity_scale.get(name, scale)
        scales.append(1.0 if scale is None else float(scale))
    return scales
