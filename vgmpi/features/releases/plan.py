"""Plan of releases: what is released at which time."""

from typing import Any

from vgmpi.planning.feature_plan import FeaturePlan, ReleasedParticles


class ReleasesPlan(FeaturePlan):
    """Releases of a run.

    Attributes:
        wall_opening_times: Time [s] at which each wall vanishes, None for never, shape (6,).
        particles: Particles that are released, by groups.
    """

    name, joins_compilation = "releases", False

    def __init__(
        self,
        wall_opening_times: tuple[float | None, ...],
        particles: tuple[ReleasedParticles, ...],
    ):
        """Take the walls and the particles."""
        self.wall_opening_times, self.particles = wall_opening_times, particles

    def start(self, context: Any) -> Any:
        """Return the releases as they act in a run.

        Args:
            context: See `FeaturePlan.start`.
        """
        from .coupling import Releases  # it compiles

        return Releases(self, context)
