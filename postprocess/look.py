"""What a run looks like at a frame: rest Gaussians and moving particles become things to draw."""

import logging

import numpy as np

from postprocess import shade
from postprocess.frame_colours import FrameColours
from postprocess.parts import (
    BALL,
    FIXED,
    FOLLOW,
    ROUND,
    SWELL,
    Part,
    Passive,
    Scenery,
    ViewColours,
    moving,
)
from postprocess.settings import LookSettings, SettingsError
from vgmpi.gaussians import evolve
from vgmpi.misspelt import nearest
from vgmpi.output.read import RunError
from vgmpi.splatting.splat import ALPHA_MIN, Splats

log = logging.getLogger("vgmpi")

FAINT = 0.02  # fluid opacity up to which 1/255 would cut a quarter or more of the fluid away
ALPHA_MIN_FAINT = 1e-4


class Look:
    """All that does not change from frame to frame, worked out once.

    run: vgmpi.output.read.RunFiles, or anything with the same `objects` and `gaussians`.
    chosen: the table [look] of render.toml. Raises SettingsError.
    """

    def __init__(self, run, chosen: LookSettings | None = None):
        chosen = chosen or LookSettings()
        rest = run.gaussians
        self.run = run
        self.objects = run.objects
        self.object = np.asarray(rest.object)
        fluid = np.array([o.get("family") == "fluid" for o in self.objects] or [False])
        rules = np.array([_rule(o, chosen) for o in self.objects] or [FIXED])
        turns = np.array([_turns(o, chosen) for o in self.objects] or [False])
        factor = np.array(_opacity_scales(self.objects, chosen) or [1.0])
        self.fluid = fluid[self.object]
        self.rule = rules[self.object]
        self.turns = turns[self.object]
        self.opacity = np.asarray(rest.opacity, dtype=np.float64) * factor[self.object]
        self.shade = getattr(rest, "shade", None)  # of light painted on colours
        self.opacity_scales = np.array(
            [chosen.opacity_scale.get(str(o.get("name")), np.nan) for o in self.objects] or [np.nan]
        )
        self.vol0 = np.asarray(rest.vol0, dtype=np.float64)
        self.cov0 = np.asarray(rest.cov0, dtype=np.float64)
        self.spacing = float(np.cbrt(np.median(self.vol0))) if len(self.vol0) else 1.0
        self.grain = _grain(self.objects, chosen)
        self.color = ViewColours(np.asarray(rest.sh))
        self.colours = FrameColours(run, chosen)
        self.scenery = None
        scenery = getattr(rest, "scenery", None)
        if scenery is not None and len(scenery.x0):
            self.scenery = Scenery(scenery, self.objects, factor)
        self.passive = None
        if getattr(rest, "passive", None) is not None:
            self.passive = Passive(rest, rules, turns, factor)

    def frame(self, index: int) -> dict[str, np.ndarray]:
        """Frame `index` of the run, with the colours it has then as "sh" (n, K, 3) where colour
        travels."""
        frame = self.run.frame(index)
        self.check(frame, f"frame {index}")
        sh = self.colours.at(index, frame)
        return frame if sh is None else {**frame, "sh": sh}

    def check(self, frame: dict[str, np.ndarray], name: str = "a frame") -> None:
        """Raises RunError if a frame does not belong to the run, or cannot be drawn."""
        rows = np.asarray(frame["id"])
        if len(rows) and not 0 <= rows.min() <= rows.max() < len(self.object):
            raise RunError(f"{name} holds particles that gaussians.h5 does not know")
        for field in ("x", "F", "J"):
            if field in frame and not np.isfinite(frame[field]).all():
                raise RunError(f"{name} holds a {field} that is no number")
        if self.scenery is not None and len(frame.get("poses", ())) != len(moving(self.objects)):
            raise RunError(f"{name} does not say where each object is that moves")

    def splats(self, frame: dict[str, np.ndarray], eye: np.ndarray) -> Splats:
        """The Gaussians of a frame as seen from `eye` [m]; scenery first.

        frame: arrays id, x, and J (all but elastic bodies), F (those) as in the frame's file; and
        sh where the colours are no longer those at rest (see `frame`). Raises RunError.
        """
        self.check(frame)
        return seen(self.parts(frame), eye)

    def parts(self, frame: dict[str, np.ndarray]) -> list[Part]:
        """The same before anybody looks at it, of what `frame` gives. Raises RunError."""
        rows = np.asarray(frame["id"])
        x = np.asarray(frame["x"], dtype=np.float64)
        cov = self._covariances(rows, frame)
        color, at = self.color, rows
        if "sh" in frame:
            color, at = ViewColours(np.asarray(frame["sh"])), np.arange(len(rows))
        turning = np.flatnonzero(self.turns[rows] & color.view_dependent[at])
        F = _deformation(frame)[turning] if len(turning) else None
        parts = [Part(x, cov, self.opacity[rows], color, at, turning, F)]
        if self.grain is not None:
            parts[0] = parts[0].brighter(1 + self.grain[self.object[rows]] * _random(rows))
        if self.passive is not None:
            parts.append(self.passive.part(frame))
        if self.scenery is not None:
            parts.insert(0, self.scenery.part(frame))
        return parts

    def _covariances(self, rows: np.ndarray, frame: dict[str, np.ndarray]) -> np.ndarray:
        """[m2], (n, 6), by the rule of each row's body."""
        J = np.asarray(frame["J"]) if "J" in frame else np.ones(len(rows))
        cov = self.cov0[rows]
        at = {rule: np.flatnonzero(self.rule[rows] == rule) for rule in (FOLLOW, SWELL, BALL)}
        if len(of := at[FOLLOW]):
            shade.solid(self.cov0, rows, of, _deformation(frame), cov)
        if len(of := at[SWELL]):
            cov[of] = evolve.solid(cov[of], evolve.swollen(J[of]))
        if len(of := at[BALL]):
            cov[of] = evolve.fluid(self.vol0[rows[of]], J[of])
        if len(of := np.flatnonzero(self.rule[rows] == ROUND)):
            cov[of] = evolve.rounded(cov[of], J[of])
        return cov

    def alpha_min(self, asked: float | None, surface: bool = False) -> float:
        """The alpha below which a Gaussian is left out of a pixel: as asked, or what suits the run.

        Says so when it is not the usual 1/255, and warns of objects that nobody will see. surface:
        whether fluids are drawn with one, and not as Gaussians.
        """
        alpha_min = asked
        if alpha_min is None:
            # a scene gives every object one: 1/255 where nobody thought about it
            alpha_min = min([o["alpha_min"] for o in self.objects if o.get("alpha_min")] or [1.0])
            alpha_min = ALPHA_MIN if alpha_min == 1.0 else alpha_min
            fluid = self.opacity[self.fluid & (self.opacity > 0) & (not surface)]
            faint = len(fluid) > 0 and np.median(fluid) <= FAINT
            if faint and np.isclose(alpha_min, ALPHA_MIN):
                alpha_min = ALPHA_MIN_FAINT
            if alpha_min < 0.999 * ALPHA_MIN:
                own = "an object's alpha_min, or its opacity_scale below 0.1"
                reason = "the fluid is faint" if faint else own
                said = "faint Gaussians are drawn too, down to alpha_min = %g (usual: 1/255): %s"
                log.info(said, alpha_min, reason)
        for number, entry in enumerate(self.objects):
            if surface and entry.get("family") == "fluid":
                continue
            own = self.opacity[self.object == number]
            lost = np.count_nonzero(own < alpha_min)
            if lost and lost > 0.05 * len(own):
                log.warning(
                    "%d of %d Gaussians of '%s' are fainter than alpha_min = %g and vanish: "
                    "lower alpha_min or raise opacity_scale",
                    lost,
                    len(own),
                    entry.get("name", number),
                    alpha_min,
                )
        return alpha_min


def seen(parts: list[Part], eye: np.ndarray) -> Splats:
    """The Gaussians of a frame as seen from `eye` [m]; parts: of Look.parts, for any eye."""
    arrays = [part.seen_from(eye) for part in parts]
    if len(arrays) == 1:
        return Splats(*arrays[0])
    return Splats(*(np.concatenate(fields) for fields in zip(*arrays)))


def _grain(objects: list[dict], chosen: LookSettings) -> np.ndarray | None:
    """How much brighter or darker each object's particles may be than their colour, (objects,)."""
    if not chosen.grain:
        return None
    names = [str(entry.get("name")) for entry in objects]
    _known("look.grain", chosen.grain, names)
    return np.array([chosen.grain.get(name, 0.0) for name in names])


def _random(rows: np.ndarray) -> np.ndarray:
    """A number of -1..1 for each particle, always the same for its row (S. Vigna's splitmix64)."""
    bits = (rows.astype(np.uint64) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return (bits >> np.uint64(11)).astype(np.float64) * 2.0**-52 - 1.0


def _known(key: str, said: dict, names: list[str]) -> None:
    for name in said:
        if name not in names:
            near = nearest(name, names)
            text = f"there is no object '{name}'{near}; known: {', '.join(names)}"
            raise SettingsError([f"{key}: {text}"])


def _deformation(frame: dict[str, np.ndarray]) -> np.ndarray:
    if "F" not in frame:
        raise RunError("a frame with solids lacks the field F: they cannot be drawn")
    return np.asarray(frame["F"])


def _deforms(entry: dict) -> bool:
    """Whether F of the frames is that of the object's particles."""
    return bool(entry.get("deforms", entry.get("family") == "solid"))


def _rule(entry: dict, chosen: LookSettings) -> int:
    """How the shapes of an object's Gaussians change."""
    if chosen.covariance == "fixed":
        return FIXED
    follow = FOLLOW if _deforms(entry) else SWELL
    if entry.get("family") not in evolve.BALLS:
        return follow
    usual = "deformation" if _deforms(entry) else "volume"
    return {"volume": BALL, "radius": ROUND, "deformation": follow}[chosen.normalise or usual]


def _turns(entry: dict, chosen: LookSettings) -> bool:
    """Whether the colours of an object's Gaussians turn with the rotation in F."""
    follows = _rule(entry, chosen) == FOLLOW or entry.get("family") not in evolve.BALLS
    return chosen.harmonics == "rotate" and _deforms(entry) and follows


def _opacity_scales(objects: list[dict], chosen: LookSettings) -> list[float]:
    """The factor on the opacities of each object: fluids are drawn thinner."""
    names = [str(entry.get("name")) for entry in objects]
    _known("look.opacity_scale", chosen.opacity_scale, names)
    if chosen.opacity == "fixed":
        return [1.0] * len(objects)
    scales = []
    for name, entry in zip(names, objects):
        scale = entry.get("opacity_scale") if entry.get("family") == "fluid" else None
        scale = chosen.opacity_scale.get(name, scale)
        scales.append(1.0 if scale is None else float(scale))
    return scales
