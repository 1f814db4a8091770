"""Base of elastoplastic laws: the Hencky elasticity of the elastic part."""

from .material import Material
from .tensor_math import hencky


class ElastoplasticMaterial(Material):
    """Base of laws with mu and lam [Pa] and density whose state begins with b_e - I.

    b_e - I has six numbers. A subclass defines `advance`, the return mapping
    (materials/tensor_math/hencky.py).
    """

    @staticmethod
    def stress(law, state, L):
        """Return the Kirchhoff stress (00, 11, 22, 01, 02, 12) [Pa]."""
        return hencky.stress(law.mu, law.lam, state[:6])

    @staticmethod
    def volume_ratio(law, state):
        """Return the elastic volume ratio."""
        return hencky.volume_ratio(state[:6])

    @staticmethod
    def wave_speed2(law, state):
        """Return a bound on the squared wave speed [m2/s2]."""
        return hencky.acoustic_modulus_bound(law.mu, law.lam, state[:6]) / law.density

    @staticmethod
    def energy(law, state):
        """Return the elastic energy per rest volume [J/m3]."""
        return hencky.energy(law.mu, law.lam, state[:6])
