"""Gathering of phases that share space and use FLIP or AFLIP, a kind of auxiliary_gather.py."""

from typing import NamedTuple

from .auxiliary_gather import (
    FlipGather,
    MixtureGather,
    advection_velocity,
    displacement,
    gather_batch,
    load_patches,
    max_velocity,
    mixture_wave_speed_squared,
    particle_velocity,
    velocity_gradient,
)


class MixtureFlipGather(NamedTuple):
    """Kind of phases that share space and use FLIP or AFLIP."""

    sharing: MixtureGather
    blend: FlipGather


@load_patches.of(MixtureFlipGather)
def _(kind, blocks, box, mirror, real, ghosts, s):
    load_patches(kind.sharing, blocks, box, mirror, real, ghosts, s)
    load_patches(kind.blend, blocks, box, mirror, real, ghosts, s)


@gather_batch.of(MixtureFlipGather)
def _(kind, count, weights, records, base, real, extra):
    gather_batch(kind.sharing, count, weights, records, base, real, extra)
    gather_batch(kind.blend, count, weights, records, base, real, extra)


@particle_velocity.of(MixtureFlipGather)
def _(kind, f, p, cap, extra, n, v):
    particle_velocity(kind.blend, f, p, cap, extra, n, v)


@max_velocity.of(MixtureFlipGather)
def _(kind, f, p, cap, displacement, scale):
    return max_velocity(kind.blend, f, p, cap, displacement, scale)


@advection_velocity.of(MixtureFlipGather)
def _(kind, split, extra, n, v):
    return advection_velocity(kind.sharing, split, extra, n, v)


displacement.of(MixtureFlipGather)(displacement.table[MixtureGather])


@velocity_gradient.of(MixtureFlipGather)
def _(kind, split, f, p, cap, extra, n, L, fill, slope, numbers):
    return velocity_gradient(kind.sharing, split, f, p, cap, extra, n, L, fill, slope, numbers)


@mixture_wave_speed_squared.of(MixtureFlipGather)
def _(kind, f, p, cap, numbers, wave2):
    return mixture_wave_speed_squared(kind.sharing, f, p, cap, numbers, wave2)
