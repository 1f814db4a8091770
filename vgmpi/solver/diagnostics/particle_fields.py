"""Optional fields of frames that are computed from the particles: stress, pressure and strain."""

import numpy as np

from vgmpi.materials.continuum_fields import cauchy_stress, logarithmic_strain, mean_pressure
from vgmpi.parallel.particle_group import ParticleGroup


def continuum_rows(
    group: ParticleGroup, indices: np.ndarray, names: tuple[str, ...]
) -> dict[str, np.ndarray]:
    """Return those of the fields stress, pressure and strain that `names` lists.

    Args:
        group: Particle group.
        indices: Indices of its particles, shape (n,).
        names: Fields of a frame.

    Returns:
        Rows in the order of `indices`: stress (n, 6) [Pa], pressure (n,) [Pa], strain (n, 6).
    """
    fields: dict[str, np.ndarray] = {}
    if not {"stress", "pressure", "strain"}.intersection(names):
        return fields
    law = group.plan.law
    state = {name: group.get(name, indices).T for name in group.plan.carries}
    if "stress" in names or "pressure" in names:
        stress = cauchy_stress(law, state, group.get("C", indices).T)
        fields["stress"], fields["pressure"] = stress, mean_pressure(stress)
    if "strain" in names:
        fields["strain"] = logarithmic_strain(law, state)
    return {name: rows for name, rows in fields.items() if name in names}
