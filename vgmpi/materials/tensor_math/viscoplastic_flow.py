"""Viscous flow beyond a yield stress, implicit in time, for every engine.

In simple shear a Herschel-Bulkley body of shear modulus mu carries tau = tau_y + K g^n, where g is
the rate of its plastic shear. In general tau = sqrt(s : s / 2) of the deviator s of stress and g =
sqrt(2 D_p : D_p) of the plastic rate D_p = (g / 2 tau) s. A step dt, first taken as if all of it
were elastic, leads to tau'; if that is beyond tau_y, the step ends at

    tau = tau' - mu dt g(tau),   g = ((tau - tau_y) / K)^(1/n)

(backward Euler; Simo and Hughes, Computational Inelasticity, 1998, section 3.7): stable for any dt,
so that viscosity puts no bound on it. Of x = tau' - tau_y the flow takes the fraction z: tau = tau'
- z x, with z in (0, 1). The functions return z; a yield surface without viscosity has z = 1.
"""

import numpy as np

from .select import select


def bingham(stiffness, viscosity):
    """Return the fraction of the excess stress that flow takes in a step, for n = 1.

    Args:
        stiffness: mu dt [Pa s].
        viscosity: K [Pa s].
    """
    return stiffness / (stiffness + viscosity)


def herschel_bulkley(excess, stiffness, log_consistency, index):
    """Return the fraction of the excess stress that flow takes, for n from 0.2 to 2.

    With g = z x / (mu dt) the equation is a z^n + z = 1, a = K (x / mu dt)^n / x. In u = ln z it
    reads u + ln(1 + a exp((n - 1) u)) = 0: its left side is convex and rises with a slope between n
    and 1 for any a, so Newton's steps from u = min(0, -ln(a) / n), where the larger term alone
    would be 1, need no safeguard. After four the fraction is right to 1e-11 at n = 0.2 and to
    rounding from 0.3 on.

    Args:
        excess: tau' - tau_y > 0 [Pa].
        stiffness: mu dt [Pa s].
        log_consistency: ln(K / 1 Pa s^n).
        index: n.
    """
    log_a = log_consistency + index * np.log(excess / stiffness) - np.log(excess)
    less = index - 1.0
    u = np.minimum(-log_a / index, 0.0)
    u = _newton(_newton(_newton(_newton(u, log_a, less), log_a, less), log_a, less), log_a, less)
    # exp(u), in the form that stays within (0, 1)
    return 1.0 - _logistic(log_a + less * u)[0]


def _newton(u, log_a, less):
    """Return u after one Newton step."""
    v = log_a + less * u
    share, log_sum = _logistic(v)
    return u - (u + log_sum) / (1.0 + less * share)


def _logistic(v):
    """Return 1 / (1 + exp(-v)) and ln(1 + exp(v)), without overflow."""
    small = np.exp(-np.abs(v))
    share = select(v > 0.0, 1.0, small) / (1.0 + small)
    return share, np.maximum(v, 0.0) + np.log1p(small)
