"""Stress and strain of particles for output, by the functions of their own law.

The functions take the law and the state of n particles by name, with a row per number, as
`Material.carries` lists them. They serve every law: states called H, B and theta have the meaning
of HyperelasticMaterial, ElastoplasticMaterial and Liquid.
"""

import numpy as np

from .material import law_function
from .tensor_math.hencky import principal_log_strains
from .tensor_math.symmetric_eigen import eigen, from_principal
from .tensor_math.tensor import left_cauchy_green_minus_one

VTK_ORDER = [0, 1, 2, 3, 5, 4]  # entries of (00, 11, 22, 01, 02, 12) as VTK orders them
# state variables that hold the logarithm of the volume ratio of the inelastic part
INELASTIC_VOLUME = ("v_c", "ln_Jp")

State = dict[str, np.ndarray]


def cauchy_stress(law: tuple, state: State, L: np.ndarray) -> np.ndarray:
    """Return the Cauchy stress, the Kirchhoff stress over the total volume ratio.

    Args:
        law: Parameters of the law.
        state: State variables, each of shape (width, n).
        L: Velocity gradients, row by row, shape (9, n) [1/s].

    Returns:
        Entries xx, yy, zz, xy, yz, xz, shape (n, 6) [Pa].
    """
    rows = tuple(row for values in state.values() for row in values)
    ratio = law_function(law, "volume_ratio")(law, rows)
    for name in INELASTIC_VOLUME:
        if name in state:
            ratio = ratio * np.exp(state[name][0])
    tau = law_function(law, "stress")(law, rows, tuple(L))
    return _in_vtk_order([component / ratio for component in tau], L.shape[1])


def mean_pressure(stress: np.ndarray) -> np.ndarray:
    """Return the pressure (n,) of stresses (n, 6), minus a third of their traces, in their unit."""
    return -(stress[:, 0] + stress[:, 1] + stress[:, 2]) / 3.0


def logarithmic_strain(law: tuple, state: State) -> np.ndarray:
    """Return the logarithmic strain ln(b) / 2 of the deformation that the state holds.

    It is total for elastic solids, and elastic for plastic materials. Its trace is the logarithm of
    the law's volume ratio. A state without shape has the isotropic strain of its volume ratio.

    Args:
        law: Parameters of the law.
        state: State variables, each of shape (width, n).

    Returns:
        Entries xx, yy, zz, xy, yz, xz, shape (n, 6).
    """
    doubles = {name: values.astype(np.float64) for name, values in state.items()}
    count = len(next(iter(state.values()))[0])
    strain = [np.zeros(count)] * 6
    if "H" in doubles:
        strain = _half_logarithm(left_cauchy_green_minus_one(tuple(doubles["H"])))
    elif "B" in doubles:
        strain = _half_logarithm(tuple(doubles["B"]))
    if "H" not in doubles and ("theta" in doubles or "B" not in doubles):
        # b_e of a liquid has the volume ratio 1, and its volume is apart
        rows = tuple(row for values in doubles.values() for row in values)
        volume = np.log(law_function(law, "volume_ratio")(law, rows))
        mean = (volume - (strain[0] + strain[1] + strain[2])) / 3.0
        strain = [strain[0] + mean, strain[1] + mean, strain[2] + mean, *strain[3:]]
    return _in_vtk_order(strain, count)


def _half_logarithm(b) -> list:
    """Return half the logarithm of b from b - I, both as (00, 11, 22, 01, 02, 12)."""
    d, q = eigen(b)
    return list(from_principal(q, principal_log_strains(d)))


def _in_vtk_order(entries, count: int) -> np.ndarray:
    """Return entries (00, 11, 22, 01, 02, 12) of `count` tensors as rows in the order of VTK."""
    return np.stack([np.broadcast_to(entries[k], count) for k in VTK_ORDER], 1)
