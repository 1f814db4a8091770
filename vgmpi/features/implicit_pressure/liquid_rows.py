"""Liquids at the nodes: each has a velocity of its own, and all answer to one pressure.

What shares a node shares the pressure by its part of the volume. With the volumes V_k of the
liquids at a node, their masses m_k, relative to those of a full cell, and a_k = V_k / sum V,

    v_k = v_k + r_k D^T phi,     r_k = a_k / m_k,     response of the node: sum a_k r_k

Their relative motion answers by the part s: with their sums A and M of a_k and m_k,
r_k = A / M + s (a_k / m_k - A / M). In a mixture, s is what friction leaves of it in a step. Of
liquids that do not mix, and of mixtures as a whole, the lightest, l, has an added mass:
s = rho_l / (rho_l + C (1 - a_l) rho), where C = c ((rho - rho_l) / (rho + rho_l))^2 with the mean
density rho; c is 1/2 for a sphere.
See docs/explanation/implicit-pressure.md.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from vgmpi.parallel.exchange_topology import ExchangeTopology
from vgmpi.planning.plan import Plan
from vgmpi.runtime.jit import always_inline

from .plan import LIQUID_VOLUME, PARTICLE_PRESSURE, liquid_groups

ADDED_MASS = 0.5  # [-] of a sphere, relative to the mass of what it displaces


class LiquidRows(NamedTuple):
    """Velocity fields of the liquids at the nodes of blocks: a row is a block of one phase."""

    first: np.ndarray  # (blocks + 1,) first row of each block
    phase: np.ndarray  # (rows,) its phase
    per_cell: np.ndarray  # (phases,) [1/kg] inverse mass of a cell full of the lightest, or 0
    density: np.ndarray  # (phases,) [-] relative to that of the heaviest liquid; 0: several
    mixture: np.ndarray  # (phases,) number of the mixture, or -1
    slip: np.ndarray  # (phases,) [-] part of the relative motion in it that a step leaves
    parts: np.ndarray  # (64 rows,) r_k over the response of the node; no rows for a lone liquid
    pressures: np.ndarray  # (rows, 256) fourth number: volume times relative pressure [m3]
    volumes: np.ndarray  # (rows, 256) fourth number: volume [m3]; no rows without `density` 0
    dx: float  # [m] cell size
    per_volume: float  # [1/m3] inverse volume of a cell
    per_mass: float  # [1/kg] inverse mass of a cell full of the heaviest liquid
    added: float  # [-] ADDED_MASS, in the working precision


@always_inline
def volume_of_row(r, q, liquids, velocity):
    """Return the volume of a row at a node, relative to that of a cell, 0 for what is no liquid."""
    phase = liquids.phase[r]
    if liquids.density[phase] > 0:
        return velocity[r, 4 * q + 3] * liquids.per_cell[phase]
    return liquids.volumes[r, 4 * q + 3] * liquids.per_volume


@always_inline
def mass_of_row(r, q, volume, liquids, velocity):
    """Return the mass of a row at a node, relative to that of a cell full of the heaviest liquid.

    Args:
        r, q, liquids, velocity: See `volume_of_row`.
        volume: Its result.
    """
    density = liquids.density[liquids.phase[r]]
    return volume * density if density > 0 else velocity[r, 4 * q + 3] * liquids.per_mass


@always_inline
def filled_part(b, q, liquids, velocity):
    """Return the volume of all liquids at a node, relative to that of a cell.

    Args:
        b, q: Block, and number of the node in it.
        liquids: LiquidRows.
        velocity: Velocities [m/s] and masses [kg] of the rows, shape (rows, 256).
    """
    total = velocity.dtype.type(0.0)
    for r in range(liquids.first[b], liquids.first[b + 1]):
        total += volume_of_row(r, q, liquids, velocity)
    return total


@always_inline
def _sums_of_mixture(r, b, q, liquids, velocity):
    """Return volume and mass at a node of all rows in the mixture of a row, or of the row alone.

    Args:
        r: The row.
        b, q, liquids, velocity: See `filled_part`.
    """
    mixture = liquids.mixture[liquids.phase[r]]
    volume = volume_of_row(r, q, liquids, velocity)
    mass = mass_of_row(r, q, volume, liquids, velocity)
    if mixture >= 0:
        for k in range(liquids.first[b], liquids.first[b + 1]):
            if k != r and liquids.mixture[liquids.phase[k]] == mixture:
                own = volume_of_row(k, q, liquids, velocity)
                volume += own
                mass += mass_of_row(k, q, own, liquids, velocity)
    return volume, mass


@always_inline
def _added_slip(volume, mass, lightest, of_lightest, factor):
    """Return the part of relative motion that the added mass of the lightest liquid leaves.

    Args:
        volume, mass: Sums of all liquids at a node.
        lightest, of_lightest: Mass and volume of the lightest.
        factor: ADDED_MASS.
    """
    density = lightest / of_lightest
    contrast = (mass - volume * density) / (mass + volume * density)
    added = factor * contrast * contrast * (volume - of_lightest) * mass
    return density * volume * volume / (density * volume * volume + added)


@always_inline
def _response_of_row(r, b, q, fill, liquids, velocity):
    """Return r_k of a row at a node.

    Args:
        r: The row.
        b, q, liquids, velocity: See `filled_part`.
        fill: Result of `filled_part`, not 0.
    """
    own = volume_of_row(r, q, liquids, velocity)
    own_mass = mass_of_row(r, q, own, liquids, velocity)
    if not own_mass > 0:
        return fill - fill
    # of a liquid alone as where no other phase has a row: which rows there are depends on the rank
    response = fill / fill / own_mass if own == fill else own / (fill * own_mass)
    group, group_mass = _sums_of_mixture(r, b, q, liquids, velocity)
    if group > own:  # it mixes with others
        mean = group / (fill * group_mass)
        response = mean + liquids.slip[liquids.phase[r]] * (response - mean)
    if fill > group:  # a mixture is like one liquid beside others
        total, lightest, of_lightest = own_mass - own_mass, group_mass, group
        for k in range(liquids.first[b], liquids.first[b + 1]):
            own = volume_of_row(k, q, liquids, velocity)
            if own > 0:
                total += mass_of_row(k, q, own, liquids, velocity)
                volume, mass = _sums_of_mixture(k, b, q, liquids, velocity)
                if mass * of_lightest < lightest * volume:
                    lightest, of_lightest = mass, volume
        slip = _added_slip(fill, total, lightest, of_lightest, liquids.added)
        mean, of_group = fill / (fill * total), group / (fill * group_mass)
        response += (mean + slip * (of_group - mean)) - of_group
    return response


@always_inline
def response_of_liquids(b, q, fill, liquids, velocity):
    """Return the response of all liquids at a node.

    Args:
        b, q, liquids, velocity: See `filled_part`.
        fill: Result of `filled_part`, not 0.
    """
    if len(liquids.parts) == 0:
        return (fill / fill) / fill
    total = fill - fill
    for r in range(liquids.first[b], liquids.first[b + 1]):
        amount = volume_of_row(r, q, liquids, velocity)
        if amount > 0:
            total += amount / fill * _response_of_row(r, b, q, fill, liquids, velocity)
    return total


@always_inline
def mean_velocity(b, q, axis, fill, liquids, velocity):
    """Return the mean velocity of all liquids at a node along an axis, by volume [m/s].

    Args:
        b, q, liquids, velocity: See `filled_part`.
        axis: The axis.
        fill: Result of `filled_part`.
    """
    if len(liquids.parts) == 0:
        return velocity[liquids.first[b], 4 * q + axis]
    total = velocity.dtype.type(0.0)
    for r in range(liquids.first[b], liquids.first[b + 1]):
        amount = volume_of_row(r, q, liquids, velocity)
        if amount > 0:
            total += amount / fill * velocity[r, 4 * q + axis]
    return total


@always_inline
def part_of_row(r, q, liquids):
    """Return r_k over the response of the node for a row, 0 for what is no liquid.

    Args:
        r: The row.
        q: Number of the node in its block.
        liquids: LiquidRows.
    """
    return liquids.parts[64 * r + q] if len(liquids.parts) > 0 else liquids.slip.dtype.type(1.0)


@always_inline
def set_parts(b, q, fill, liquids, velocity):
    """Set `parts` of the rows of a block at a node, and return the response of its liquids.

    Args:
        b, q, liquids, velocity: See `filled_part`.
        fill: Result of `filled_part`, not 0.
    """
    total = fill - fill
    for r in range(liquids.first[b], liquids.first[b + 1]):
        amount, response = volume_of_row(r, q, liquids, velocity), fill - fill
        if amount > 0:
            response = _response_of_row(r, b, q, fill, liquids, velocity)
            total += amount / fill * response
        liquids.parts[64 * r + q] = response
    for r in range(liquids.first[b], liquids.first[b + 1]):
        if total > 0:
            liquids.parts[64 * r + q] /= total
    return total


class Liquids:
    """Liquids of a run at the nodes of a rank.

    Attributes:
        mass_of_cell: Mass of a cell full of the heaviest one [kg].
        stiffness: Relative pressure of particles per potential of a cell and inverse time step.
    """

    def __init__(self, plan: Plan):
        """Take the liquids of a plan, without rows."""
        count, real, dx3 = len(plan.phases), plan.real, plan.dx**3
        own = liquid_groups(plan)
        heaviest = max(group.density for group in own)
        self.mass_of_cell = heaviest * dx3
        law: Any = own[0].law  # all have one coefficient
        self.stiffness = float(law.k) / (heaviest * plan.dx**2)
        per_cell, density = np.zeros(count), np.ones(count)
        for phase in {group.phase for group in own}:
            densities = {group.density for group in own if group.phase == phase}
            per_cell[phase] = 1.0 / (min(densities) * dx3)
            density[phase] = min(densities) / heaviest if len(densities) == 1 else 0.0
        relaxation = (feature.slip_relaxation for feature in plan.features)
        self.relaxation = next((each for each in relaxation if each is not None), None)
        sets = np.full(count, -1) if self.relaxation is None else self.relaxation.sets
        none, ones, no_parts = np.zeros(0, np.int64), np.ones(count, real), np.zeros(0, real)
        numbers = 1.0 / dx3, 1.0 / (heaviest * dx3), ADDED_MASS
        self.rows = LiquidRows(
            none, none, per_cell.astype(real), density.astype(real), sets, ones, no_parts,
            np.zeros((0, 256), real), np.zeros((0, 256), real), plan.dx, *map(real.type, numbers),
        )  # fmt: skip
        self.is_lone = density.tolist() == [1.0]

    def set_topology(self, tables: ExchangeTopology) -> None:
        """Take new tables after a sort."""
        parts = np.zeros(0 if self.is_lone else 64 * len(tables.phase), self.rows.slip.dtype)
        self.rows = self.rows._replace(first=tables.first, phase=tables.phase, parts=parts)

    def rows_in(self, fields: Mapping[str, Any], dt: float) -> LiquidRows:
        """Return the liquids at the nodes in a step.

        Args:
            fields: Nodal fields by name.
            dt: Length of the step [s].
        """
        self.rows = self.rows._replace(pressures=fields[PARTICLE_PRESSURE].nodes)
        if (self.rows.density == 0).any():
            self.rows = self.rows._replace(volumes=fields[LIQUID_VOLUME].nodes)
        if self.relaxation is None:
            return self.rows
        times = np.maximum(self.relaxation.times, np.finfo(float).tiny)
        slip = 1.0 / (1.0 + np.minimum(dt / times, np.finfo(float).max))
        return self.rows._replace(slip=slip.astype(self.rows.slip.dtype))
