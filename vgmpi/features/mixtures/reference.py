"""Mixture coupling of phases that share space: mixing fluids, and sand with pore fluid.

Formulas and sources are in docs/explanation/mixtures.md. All arrays run over phases, then nodes.
"""

from typing import Any

import numpy as np

from vgmpi.features.active_feature import DenseStage
from vgmpi.parallel.particle_group import ParticleGroup

from .gather import OVERFILL_RELAXATION_RATE
from .kernels import MIN_POROSITY, MIN_VOLUME_FRACTION
from .rules import InteractionRules


def _ratio(a, b):
    """Return a / b, 0 where b is not positive."""
    return np.where(b > 0, a / np.where(b > 0, b, 1.0), 0.0)


class DenseMixtures(DenseStage):
    """Coupling of a scene's sets of phases, one set after the other."""

    def __init__(self, rules: InteractionRules, densities: np.ndarray, dense: Any):
        """Take the rules, the densities of the phases' lightest materials, and the nodes."""
        self.rules, self.dense, self.dx = rules, dense, dense.dx
        self.densities = densities[:, None, None, None]  # of each phase's lightest material
        self.sets = [np.flatnonzero(rules.mixture_set == k) for k in range(rules.sets)]
        self.fluid = np.asarray(rules.fluid, bool)[:, None, None, None]

    def after_stress(self, nodes: Any, v: np.ndarray, mass: np.ndarray) -> None:
        """Couple the phases.

        Args:
            nodes, v, mass: See `DenseStage.after_stress`.
        """
        self.V = self.volumes(mass, nodes.counted[..., 0])
        self.drift = self.apply(v, mass, nodes.forces, self.V, nodes.offset, nodes.dt)

    def after_walls(self, nodes: Any, v: np.ndarray, mass: np.ndarray) -> np.ndarray:
        """Find the volume flux; return the velocities without the drift.

        Args:
            nodes, v, mass: See `DenseStage.after_walls`.
        """
        self.flux_of_phases, self.share, self.full = self.flux(v, mass, self.V)
        return v - self.drift

    def gathered_fields(self, change_share: float) -> list[tuple[np.ndarray, float]]:
        """Return the volume flux and the drift.

        Args:
            change_share: See `DenseStage.gathered_fields`.
        """
        return [(self.flux_of_phases, 0.0), (self.drift, 0.0)]

    def motion(
        self, group: ParticleGroup, stencil: Any, split: np.ndarray, v: np.ndarray, L: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the velocities with the drift, and the gradients with the volume flux.

        The porosity is stored. Where volume exceeds space, the volume ratio relaxes.

        Args:
            group, stencil, split, v, L: See `DenseStage.motion`.
        """
        if not group.plan.shares_space:
            return v, L
        p, dense = group.plan.phase, self.dense
        v = v + np.where(split[:, None], dense.gather(self.drift[p], stencil), 0.0)
        flux_gradient = dense.gather_slopes(self.flux_of_phases[p], stencil, moments=True)
        rate = np.trace(flux_gradient, axis1=1, axis2=2)
        if group.plan.stores_porosity:
            symmetric = [dense.symmetrize(field[p])[..., None] for field in (self.share, self.full)]
            porosity, full = (dense.gather(field, stencil)[:, 0] for field in symmetric)
            porosity = np.where(split, np.clip(porosity, MIN_POROSITY, 1.0), 1.0)
            group.put("share", group.index(), porosity[:, None])
            rate = rate / porosity - OVERFILL_RELAXATION_RATE * np.maximum(full - 1.0, 0.0)
        added = (rate - np.trace(L, axis1=1, axis2=2)) / 3.0
        return v, np.where(split[:, None, None], L + added[:, None, None] * np.eye(3), L)

    def fill_fraction(self, group: ParticleGroup, stencil: Any) -> np.ndarray | None:
        """Return the filled fraction of the space around particles that share space.

        Args:
            group, stencil: See `DenseStage.fill_fraction`.
        """
        if not group.plan.shares_space:
            return None
        full = self.dense.symmetrize(self.full[group.plan.phase])[..., None]
        fraction: np.ndarray = self.dense.gather(full, stencil)[:, 0]
        return fraction

    def volumes(self, mass: np.ndarray, counted: np.ndarray) -> np.ndarray:
        """Return the volume of each phase [m^3].

        Args:
            mass: Nodal masses, shape (phases, ...) [kg].
            counted: Volumes of fluids as summed at the nodes [m^3]; grains follow from their mass.
        """
        grains = self.rules.volume[:, None, None, None] * mass
        return np.where(self.fluid, np.maximum(counted, 0.0), grains)

    def _set_volumes(self, members, mass, V):
        """Return volumes of one set, sums of its fluids and grains, and the porosity."""
        V = np.where(mass[members] > 0, V[members], 0.0)
        wet = self.fluid[members]
        fluid, grains = np.where(wet, V, 0).sum(0), np.where(wet, 0, V).sum(0)
        porosity = np.maximum(
            1.0 - grains / np.maximum(fluid + grains, self.dense.space), MIN_POROSITY
        )
        return V, fluid, grains, np.where((fluid > 0) & (grains > 0), porosity, 1.0)

    def apply(self, v, mass, forces, V, offset, dt: float) -> np.ndarray:
        """Apply pressure, drift, slip and drag to the velocities.

        Args:
            v (in/out): Velocities, shape (phases, ..., 3) [m/s].
            mass: Nodal masses, shape (phases, ...) [kg].
            forces: Stress impulses that are summed separately, shape (phases, ..., 3) [kg m/s].
            V: Volumes, shape (phases, ...) [m^3].
            offset: Sums of volume times offset of the particles.
            dt: Length of the step [s].

        Returns:
            Drift velocities contained in v [m/s].
        """
        rules, drift = self.rules, np.zeros_like(v)
        for members in self.sets:
            m = mass[members]
            shared = (m > 0).sum(0) > 1
            groups = [
                (g, rules.diffusion[g], rules.slip_relaxation_time[g])
                for g in range(rules.mixing_group_count)
            ]
            for g, D, _ in groups:
                if rules.printed_mix[g]:
                    self._mix(g, v, mass, V, offset, shared, D, 0.0, -1.0, dt)
            self._pressure(members, v, mass, forces, V, shared)
            for g, D, slip in groups:
                if not rules.printed_mix[g]:
                    drift_of_group = self._mix(
                        g, v, mass, V, offset, shared, D, 1.0 / (1.0 + dt / slip), 1.0, dt
                    )
                    drift += drift_of_group
            self._drag(members, v, mass, V, dt)
        return drift

    def _pressure(self, members, v, mass, forces, V, shared):
        """Distribute the impulse of all fluids to each phase by its volume fraction."""
        volumes, fluid, grains, porosity = self._set_volumes(members, mass, V)
        wet = self.fluid[members]
        total = np.where(wet[..., None], forces[members], 0.0).sum(0)
        fraction = np.where(
            wet, porosity * _ratio(volumes, fluid), (1.0 - porosity) * _ratio(volumes, grains)
        )
        m = mass[members]
        separate = _ratio(forces[members], m[..., None])
        v[members] += np.where(
            shared[..., None], _ratio(fraction[..., None] * total, m[..., None]), separate
        )

    def _mix(self, g, v, mass, V, offset, shared, diffusion, slip_ratio, sign, dt) -> np.ndarray:
        """Apply drift (Ren 2014) and slip to the fluids of group g; return the drifts.

        slip_ratio: fraction of all other velocity differences that is kept.
        """
        in_group = (self.rules.mix == g)[:, None, None, None]
        if in_group.sum() < 2:
            return np.zeros_like(v)
        m = np.where(in_group, mass, 0.0)[..., None]
        is_shared = ((m.sum(0) > 0) & shared[..., None])[None]
        mean = _ratio((m * v).sum(0), m.sum(0))
        drift = np.zeros_like(v)
        if diffusion > 0:
            drift = self._drift(in_group, m, V, offset, sign * diffusion, dt)
        drift = np.where(is_shared & in_group[..., None], drift, 0.0)
        v[:] = np.where(is_shared & in_group[..., None], mean + slip_ratio * (v - mean) + drift, v)
        return drift

    def _drift(self, in_group, m, V, offset, strength, dt):
        """Return the drift u_k = -D (grad a_k / a_k - sum_l c_l grad a_l / a_l).

        No drift exceeds half a cell in dt; the momenta of the drifts sum to zero.
        """
        V = np.where(in_group & (m[..., 0] > 0), V, 0.0)[..., None]
        X = np.where(in_group[..., None], offset, 0.0)
        fraction = _ratio(V, V.sum(0))
        slope = (
            4.0 / self.dx**2 * _ratio(X - fraction * X.sum(0), np.broadcast_to(V.sum(0), X.shape))
        )
        u = np.where(m > 0, -strength * slope / np.maximum(fraction, MIN_VOLUME_FRACTION), 0.0)
        u = u - _ratio((m * u).sum(0), m.sum(0))
        size, limit = np.linalg.norm(u, axis=-1, keepdims=True), self.dx / (2.0 * dt)
        u = u * np.where(size > limit, limit / np.where(size > 0, size, 1.0), 1.0)
        return u - _ratio((m * u).sum(0), m.sum(0))

    def _drag(self, members, v, mass, V, dt):
        """Solve (diag(m) + L(K)) v = m v* at each node, with a general solver.

        K = dt c times the bulk volume that both phases fill.
        """
        rules = self.rules
        if not rules.has_drag:
            return
        volumes, fluid, grains, _ = self._set_volumes(members, mass, V)
        wet = np.asarray(rules.fluid, bool)[members]
        for node in map(tuple, np.argwhere((fluid > 0) & (grains > 0))):
            index = (slice(None), *node)
            m, volume = mass[(members, *node)], volumes[index]
            K = np.zeros((len(members), len(members)))
            for a, b in np.argwhere(~wet[:, None] & wet[None, :] & (volume[:, None] * volume > 0)):
                strength, n = rules.drag[members[a], members[b]], rules.porosity[members[a]]
                bulk = volume[a] / (1.0 - n) * (volume[b] / fluid[node])
                pore_volume = volume[b] / n * (volume[a] / grains[node])
                K[a, b] = K[b, a] = dt * strength * min(bulk, pore_volume)
                if rules.printed_drag[members[a], members[b]]:
                    K[a, b] = K[b, a] = strength * m[a] * m[b] / (m[a] + m[b])
            present = np.flatnonzero(m > 0)
            K = K[np.ix_(present, present)]
            matrix = np.diag(m[present] + K.sum(1)) - K
            rows = (members[present], *node)
            v[rows] = np.linalg.solve(matrix, m[present, None] * v[rows])

    def flux(self, v, mass, V):
        """Return what the particles of each phase gather.

        Args:
            v: Velocities, shape (phases, ..., 3) [m/s].
            mass: Nodal masses, shape (phases, ...) [kg].
            V: Volumes, shape (phases, ...) [m^3].

        Returns:
            Volume flux [m/s], porosity, and filled fraction of space, each of shape (phases, ...).
        """
        flux, porosity, full = v.copy(), np.ones(mass.shape), np.zeros(mass.shape)
        for members in self.sets:
            volumes, fluid, grains, set_porosity = self._set_volumes(members, mass, V)
            wet = self.fluid[members]
            fraction = np.where(
                wet,
                set_porosity * _ratio(volumes, fluid),
                (1.0 - set_porosity) * _ratio(volumes, grains),
            )
            total = (fraction[..., None] * v[members]).sum(0)
            is_coupled = ((mass[members] > 0).sum(0) > 1) & (fluid > 0)
            flux[members] = np.where(is_coupled[..., None], total, v[members])
            porosity[members] = set_porosity
            own = np.minimum(mass[members] / self.densities[members], self.dense.space)
            full[members] = np.maximum(fluid + grains, own) / self.dense.space
        return flux, porosity, full
