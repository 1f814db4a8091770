"""What laws that yield have in common: Hencky's elasticity of what has not."""

from ..device import hencky
from .base import Material


class Yielding(Material):
    """A law with mu and lam [Pa] and density whose state begins with b_e - I, six numbers.

    Its own is `advance`, the return mapping (device/hencky.py).
    """

    @staticmethod
    def stress(law, state, L):
        return hencky.stress(law.mu, law.lam, state[:6])

    @staticmethod
    def volume_ratio(law, state):
        return hencky.volume_ratio(state[:6])

    @staticmethod
    def wave_speed2(law, state):
        return hencky.stiffest(law.mu, law.lam, state[:6]) / law.density

    @staticmethod
    def energy(law, state):
        return hencky.energy(law.mu, law.lam, state[:6])
