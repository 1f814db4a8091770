"""What a run looks like at a frame: rest Gaussians and moving particles become things to draw."""

import logging
from typing import NamedTuple

import numpy as np

from postprocess import shade
from vgmpi.gaussians import evolve
from vgmpi.gaussians import sh as harmonics
from vgmpi.output.read import RunError
from vgmpi.splatting.splat import ALPHA_MIN, Splats

log = logging.getLogger("vgmpi")

FAINT = 0.02  # fluid opacity up to which 1/255 would cut a quarter or more of the fluid away
ALPHA_MIN_FAINT = 1e-4
BALLS = ("fluid", "sand", "snow")  # families whose Gaussians forget their shape


class Look:
    """All that does not change from frame to frame, worked out once.

    run: an opened run (vgmpi.output.read.Run) or anything with the same `objects` and `gaussians`.
    """

    def __init__(self, run):
        rest = run.gaussians
        self.objects = run.objects
        self.object = np.asarray(rest.object)
        fluid = np.array([o.get("family") == "fluid" for o in self.objects] or [False])
        balls = np.array([o.get("family") in BALLS for o in self.objects] or [False])
        deforms = np.array([_deforms(o) for o in self.objects] or [False])
        factor = np.array([_opacity_scale(o) for o in self.objects] or [1.0])
        self.fluid = fluid[self.object]
        self.ball = balls[self.object]
        self.deforms = deforms[self.object]
        self.opacity = np.asarray(rest.opacity, dtype=np.float64) * factor[self.object]
        self.vol0 = np.asarray(rest.vol0, dtype=np.float64)
        self.cov0 = np.asarray(rest.cov0, dtype=np.float64)
        self.color = Colors(np.asarray(rest.sh))
        self.scenery = None
        scenery = getattr(rest, "scenery", None)
        if scenery is not None and len(scenery.x0):
            self.scenery = (
                np.asarray(scenery.x0, dtype=np.float64),
                np.asarray(scenery.cov0, dtype=np.float64),
                np.asarray(scenery.opacity, dtype=np.float64),
                Colors(np.asarray(scenery.sh)),
            )

    def splats(self, frame: dict[str, np.ndarray], eye: np.ndarray) -> Splats:
        """The Gaussians of a frame as seen from `eye` [m]; scenery first, it never moves.

        frame: arrays id, x, and J (all but elastic bodies), F (those) as in the frame's file.
        Raises RunError.
        """
        parts = [part.seen_from(eye) for part in self.parts(frame)]
        return Splats(*(np.concatenate(arrays) for arrays in zip(*parts)))

    def parts(self, frame: dict[str, np.ndarray]) -> "list[Part]":
        """The same before anybody looks at it. Raises RunError."""
        rows = np.asarray(frame["id"])
        if len(rows) and not 0 <= rows.min() <= rows.max() < len(self.object):
            raise RunError("a frame holds particles that gaussians.h5 does not know")
        x = np.asarray(frame["x"], dtype=np.float64)
        J = np.asarray(frame["J"]) if "J" in frame else np.ones(len(rows))
        ball, deforms = self.ball[rows], self.deforms[rows]
        solid, rigid = np.flatnonzero(deforms), np.flatnonzero(~ball & ~deforms)
        if len(solid) and "F" not in frame:
            raise RunError("a frame with solids lacks the field F: they cannot be drawn")
        cov = np.empty((len(rows), 6))
        if len(solid):
            F = np.asarray(frame["F"])[solid]
            cov[solid] = evolve.solid(self.cov0[rows[solid]], F)
        if len(rigid):  # no F: the shape at rest, larger or smaller
            cov[rigid] = evolve.solid(self.cov0[rows[rigid]], evolve.swollen(J[rigid]))
        if ball.any():
            cov[ball] = evolve.fluid(self.vol0[rows[ball]], J[ball])
        turning = solid[self.color.view_dependent[rows[solid]]]
        F = np.asarray(frame["F"])[turning] if len(turning) else None
        parts = [Part(x, cov, self.opacity[rows], self.color, rows, turning, F)]
        if self.scenery is not None:
            x, cov, opacity, color = self.scenery
            parts.insert(0, Part(x, cov, opacity, color, np.arange(len(x))))
        return parts

    def alpha_min(self, asked: float | None) -> float:
        """The alpha below which a Gaussian is left out of a pixel: as asked, or what suits the run.

        Says so when it is not the usual 1/255, and warns of objects that nobody will see.
        """
        alpha_min = asked
        if alpha_min is None:
            # a scene gives every object one: 1/255 where nobody thought about it
            alpha_min = min([o["alpha_min"] for o in self.objects if o.get("alpha_min")] or [1.0])
            alpha_min = ALPHA_MIN if alpha_min == 1.0 else alpha_min
            fluid = self.opacity[self.fluid & (self.opacity > 0)]
            faint = len(fluid) > 0 and np.median(fluid) <= FAINT
            if faint and np.isclose(alpha_min, ALPHA_MIN):
                alpha_min = ALPHA_MIN_FAINT
            if alpha_min < 0.999 * ALPHA_MIN:
                reason = "the fluid is faint" if faint else "the scene asks for it"
                log.info("alpha_min = %g instead of 1/255: %s", alpha_min, reason)
        for number, entry in enumerate(self.objects):
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


class Colors:
    """Colours of rows of coefficients; what does not depend on the view is worked out once."""

    def __init__(self, sh: np.ndarray):
        self.sh = sh
        self.plain = harmonics.evaluate(sh[:, :1], np.zeros((len(sh), 3)))
        self.view_dependent = np.zeros(len(sh), dtype=bool)
        if sh.shape[1] > 1:
            self.view_dependent = (sh[:, 1:] != 0).any(axis=(1, 2))

    def __call__(self, rows: np.ndarray, directions: np.ndarray) -> np.ndarray:
        color = self.plain[rows]
        shiny = np.flatnonzero(self.view_dependent[rows])
        if len(shiny):
            color[shiny] = shade.evaluate(self.sh, rows[shiny], directions[shiny])
        return color


class Part(NamedTuple):
    """Gaussians of a frame. x: (n, 3) [m]. cov: (n, 6) [m2]. opacity: (n,) in 0..1.

    color, rows: their coefficients are color.sh[rows], (n, K, 3). turning: which of them have
    turned with the rotations in F (m, 9).
    """

    x: np.ndarray
    cov: np.ndarray
    opacity: np.ndarray
    color: Colors
    rows: np.ndarray
    turning: np.ndarray = np.empty(0, dtype=np.int64)
    F: np.ndarray | None = None

    def seen_from(self, eye: np.ndarray) -> tuple[np.ndarray, ...]:
        """The fields of Splats for an `eye` [m]."""
        directions = self.x - eye
        if len(self.turning):  # shows towards d what it showed at rest towards R^T d
            directions[self.turning] = shade.turn_back(self.F, directions[self.turning])
        return self.x, self.cov, self.opacity, self.color(self.rows, directions)

    def coefficients(self) -> np.ndarray:
        """Colours for any eye, turned along (n, K, 3) float32."""
        sh = np.array(self.color.sh[self.rows], dtype=np.float32)
        if len(self.turning):
            sh[self.turning] = harmonics.rotate(sh[self.turning], evolve.rotation(self.F))
        return sh


def _deforms(entry: dict) -> bool:
    """Whether F tells the shape of an object's Gaussians."""
    return bool(entry.get("deforms", entry.get("family") == "solid"))


def _opacity_scale(entry: dict) -> float:
    """The factor on the opacities of an object: fluids are drawn thinner."""
    scale = entry.get("opacity_scale")
    return float(scale) if entry.get("family") == "fluid" and scale is not None else 1.0
