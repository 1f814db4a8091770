"""What must hold for the law of every material: a new one is tested by being there.

The stress is the derivative of the energy, rotating a body changes nothing, at rest nothing
happens, the wave speed bounds the stiffness, and the compiled text does what the plain one does.
Of laws that yield F is the elastic part, the history is as at rest, and moves stay elastic where
that is said; what they do beyond is in test_sand.py, test_snow.py, test_metal.py. A history that
grows with every move, as of what hardens, is free.
"""

import ast
import inspect
import textwrap
import typing

import numba
import numpy as np
import pytest

from vgmpi.kernels.simd import material_dispatch
from vgmpi.materials import registry
from vgmpi.materials.material import FUNCTIONS, Family, state_channels

NEVER = {"yield_stress": 1e9}  # what yields has tests of its own
SAMPLES = {  # a table of each kind, other than the defaults
    "fluid": [
        {"density": 900.0, "tait_coefficient": 3e4, "tait_exponent": 7.0, "viscosity": 0.3},
        {"tait_coefficient": 1e5, "tait_exponent": 1.0},
    ],
    "elastic": [
        {"youngs_modulus": 2e5, "poisson_ratio": 0.3},
        {"density": 500.0, "youngs_modulus": 1e4, "poisson_ratio": 0.0},
        {"youngs_modulus": 1e6, "poisson_ratio": 0.45},
    ],
    "sand": [{"porosity": 0.3, "youngs_modulus": 3e5}, {"cohesion": 500.0, "poisson_ratio": 0.2}],
    "snow": [{}, {"density": 100.0, "poisson_ratio": 0.0, "hardening_coefficient": 5.0}],
    "metal": [{"youngs_modulus": 2e6, "yield_stress": 5e4, "hardening_modulus": 1e5}],
    "corotated": [
        {"youngs_modulus": 2e5, "poisson_ratio": 0.3},
        {"density": 500.0, "youngs_modulus": 1e4, "poisson_ratio": 0.0},
    ],
    "paste": [
        {"consistency_index": 3.0, "flow_index": 0.4, "shear_modulus": 3e4, **NEVER},
        {
            "consistency_index": 3.0,
            "tait_coefficient": 1e3,
            "tait_exponent": 1.0,
            "shear_modulus": 1e5,
            **NEVER,
        },
    ],
    "foam": [{"youngs_modulus": 2e3, "poisson_ratio": 0.2, "viscosity": 3.0, **NEVER}],
    "plasticine": [{"youngs_modulus": 2e6, "poisson_ratio": 0.4, **NEVER}],
}
CASES = [(kind, k) for kind in registry for k in range(len(SAMPLES.get(kind, [{}])))]
ZERO = (0.0,) * 9


@pytest.fixture(params=CASES, ids=[f"{kind}-{k}" for kind, k in CASES])
def material(request):
    kind, k = request.param
    assert kind in SAMPLES, f"give SAMPLES a table of material {kind!r}"
    return registry[kind](kind=kind, **SAMPLES[kind][k])


def of_deformation(material, F):
    """What follows from the (elastic) deformation gradient F (3, 3), by the name of the state."""
    J = np.linalg.det(F)
    b = F @ F.T
    if "theta" in material.carries:
        b = b / np.cbrt(J) ** 2  # what carries its volume apart has none in b
    six = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
    return {
        "theta": (np.log(J),),
        "H": tuple((F - np.eye(3)).flat),
        "B": tuple((b - np.eye(3))[six]),
    }


def state_of(material, F):
    """The state a body of this material carries when its (elastic) deformation gradient is F (3,
    3) and all else is as at rest.
    """
    known = of_deformation(material, F)
    assert known.keys() & material.carries, "say what this state is for a given F"
    return tuple(v for name, rest in material.carries.items() for v in known.get(name, rest))


def apart(material, state, F):
    """How far a state is from that of F, at the most: of what F tells, and of a history too where
    the law has one only beyond yield.
    """
    known, yields = of_deformation(material, F), "B" in material.carries
    told = [yields or name in known for name, rest in material.carries.items() for _ in rest]
    return np.abs(np.subtract(state, state_of(material, F)))[told].max()


def deformations(n=40, size=0.25, seed=1):
    random = np.random.default_rng(seed)
    return [np.eye(3) + random.uniform(-size, size, (3, 3)) for _ in range(n)]


def rotation(random):
    q, r = np.linalg.qr(random.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


def full(t):
    xx, yy, zz, xy, xz, yz = (float(c) for c in t)
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def stress(material, F, L=ZERO):
    return full(material.stress(material.law(), state_of(material, F), L))


def energy(material, F):
    return float(material.energy(material.law(), state_of(material, F)))


def stiffness(material):
    """A scale of stress [Pa]."""
    law = material.law()
    return float(material.wave_speed2(law, state_of(material, np.eye(3)))) * material.bulk_density


def test_stress_is_the_derivative_of_energy(material):
    """d psi = tau : (dF F^-1), by central differences in nine directions."""
    h = 1e-6
    for F in deformations():
        tau = stress(material, F)
        for a in range(3):
            for b in range(3):
                E = np.zeros((3, 3))
                E[a, b] = h
                up, down = (energy(material, (np.eye(3) + s * E) @ F) for s in (1, -1))
                assert (up - down) / (2 * h) == pytest.approx(
                    tau[a, b], abs=2e-8 * stiffness(material), rel=2e-8
                )


def test_rotating_a_body_rotates_its_stress(material):
    random = np.random.default_rng(2)
    for F in deformations(10):
        Q = rotation(random)
        assert energy(material, Q @ F) == pytest.approx(energy(material, F), rel=1e-10, abs=1e-9)
        turned = Q @ stress(material, F) @ Q.T
        assert np.abs(stress(material, Q @ F) - turned).max() < 1e-12 * stiffness(material)


def test_at_rest(material):
    law = material.law()
    rest = tuple(v for values in material.carries.values() for v in values)
    assert len(rest) == state_channels(type(law))
    assert rest == state_of(material, np.eye(3))
    assert full(material.stress(law, rest, ZERO)).tolist() == np.zeros((3, 3)).tolist()
    assert float(material.energy(law, rest)) == 0.0
    assert float(material.volume_ratio(law, rest)) == 1.0
    assert material.advance(law, rest, ZERO, 1e-3) == rest
    assert all(energy(material, F) > 0.0 for F in deformations())


def test_volume_ratio(material):
    for F in deformations():
        J = material.volume_ratio(material.law(), state_of(material, F))
        assert float(J) == pytest.approx(np.linalg.det(F), rel=1e-13)


def test_moving_by_a_gradient(material):
    """Many small steps of a constant L lead where exp(t L) does, to the first order of a step."""
    random = np.random.default_rng(3)
    L, law = random.normal(size=(3, 3)), material.law()
    if "B" in material.carries:  # pressed and sheared a little: nothing yields
        L = 2e-3 * (0.2 * L - np.eye(3))
    values, vectors = np.linalg.eig(0.2 * L)
    F = (vectors @ np.diag(np.exp(values)) @ np.linalg.inv(vectors)).real
    errors = []
    for n in (200, 400):
        state = state_of(material, np.eye(3))
        for _ in range(n):
            state = material.advance(law, state, tuple(L.flat), 0.2 / n)
        errors.append(apart(material, state, F))
    assert errors[1] < 0.55 * errors[0] or errors[1] < 1e-12
    assert errors[1] < 2e-3 * np.abs(L).max()


def test_the_wave_speed_is_a_bound(material):
    """rho0 c^2 is at least the stiffness against every plane wave, d2 psi / de2 of F -> (I + e m
    n^T) F, in every state; and it is not wasteful: at rest it is reached.
    """
    random, h, law = np.random.default_rng(4), 1e-4, material.law()
    closest = []
    for F in [np.eye(3), *deformations(60, 0.4)]:
        if np.linalg.det(F) < 0.2:
            continue
        bound = float(material.wave_speed2(law, state_of(material, F))) * material.bulk_density
        for _ in range(20):
            m, n = random.normal(size=(2, 3))
            m, n = m / np.linalg.norm(m), n / np.linalg.norm(n)
            for across in (m, n):  # n: a pressure wave
                wave = h * np.outer(across, n)
                up, here, down = (energy(material, (np.eye(3) + s * wave) @ F) for s in (1, 0, -1))
                stiff = (up - 2 * here + down) / h**2
                assert stiff <= bound * (1 + 1e-5)
                if np.array_equal(F, np.eye(3)):
                    closest.append(stiff / bound)
    assert max(closest) > 0.999


def test_viscosity_only_brakes(material):
    """The part of the stress that depends on L takes energy, and a rotation meets none."""
    random = np.random.default_rng(5)
    for F in deformations(10):
        L = random.normal(size=(3, 3))
        drag = stress(material, F, tuple(L.flat)) - stress(material, F)
        assert (drag * L).sum() >= -1e-12 * stiffness(material)
        W = L - L.T
        same = stress(material, F, tuple(W.flat)) - stress(material, F)
        assert np.abs(same).max() < 1e-12 * stiffness(material)
        nu = material.kinematic_viscosity
        D = 0.5 * (L + L.T)
        D -= np.trace(D) / 3 * np.eye(3)
        want = 2 * nu * material.bulk_density * np.linalg.det(F) * D
        assert np.allclose(drag, want, rtol=1e-9, atol=1e-12 * stiffness(material))


def test_small_steps_are_not_lost_in_single_precision(material):
    """10,000 steps that each stretch (sand: press) by 1e-9 add up: 1 + 1e-9 is 1 in single
    precision.
    """
    one, sign = np.float32, -1 if material.family == "sand" else 1
    law = type(material.law())(*(one(c) for c in material.law()))
    state = tuple(one(c) for c in state_of(material, np.eye(3)))
    L = tuple(one(c) for c in (sign, 0, 0, 0, sign, 0, 0, 0, sign))
    for _ in range(10_000):
        state = material.advance(law, state, L, one(1e-9))
    assert all(type(c) is one for c in state)
    assert apart(material, state, np.exp(sign * 1e-5) * np.eye(3)) < 1e-2 * 3e-5
    tau = stress(material, np.exp(sign * 1e-5) * np.eye(3))
    single = full(material.stress(law, state, tuple(one(0) for _ in range(9))))
    assert np.abs(single - tau).max() < 2e-2 * np.abs(tau).max()


CALLS = {  # the arguments of each function after law and state
    "advance": lambda L, dt: (L, dt),
    "stress": lambda L, dt: (L,),
    "volume_ratio": lambda L, dt: (),
    "wave_speed2": lambda L, dt: (),
    "energy": lambda L, dt: (),
}


@numba.njit
def compiled(law, state, L, dt):
    return (
        material_dispatch.advance(law, state, L, dt),
        material_dispatch.stress(law, state, L),
        material_dispatch.volume_ratio(law, state),
        material_dispatch.wave_speed2(law, state),
        material_dispatch.energy(law, state),
    )


@pytest.mark.parametrize("real", [np.float32, np.float64])
def test_compiled_law_is_the_plain_one(material, real):
    random = np.random.default_rng(6)
    law = type(material.law())(*(real(c) for c in material.law()))
    for F in deformations(20):
        state = tuple(real(c) for c in state_of(material, F))
        L = tuple(real(c) for c in random.normal(size=9))
        got = compiled(law, state, L, real(1e-3))
        for name, value in zip(FUNCTIONS, got, strict=True):
            want = getattr(material, name)(law, state, *CALLS[name](L, real(1e-3)))
            # stresses and energies are differences of larger terms, and so is what yielded
            scale = np.abs(want).max() + stiffness(material) * (name in ("stress", "energy"))
            scale += np.abs(state).max() * (name == "advance")
            assert np.abs(np.subtract(value, want)).max() <= 8 * np.finfo(real).eps * scale, name


def text_of(function):
    """Return the source of a function without its docstring and comments."""
    (tree,) = ast.parse(textwrap.dedent(inspect.getsource(function))).body
    if ast.get_docstring(tree) is not None:
        del tree.body[0]
    return ast.unparse(tree)


@pytest.mark.parametrize("kind", registry)
def test_laws_are_plain_and_whole(kind):
    """No branch on a value, so that the same text runs on arrays; all functions are there."""
    cls = registry[kind]
    for name in FUNCTIONS:
        source = text_of(getattr(cls, name))
        words = set(source.replace("(", " ").replace(":", " ").split())
        assert not words & {"if", "for", "while", "math.exp", "math.log"}, name
    assert cls.family in typing.get_args(Family)


def test_arrays_and_single_particles_agree(material):
    law = material.law()
    states = [state_of(material, F) for F in deformations(7)]
    together = tuple(np.array(c) for c in zip(*states, strict=True))
    for name in ("volume_ratio", "wave_speed2", "energy"):
        many = getattr(material, name)(law, together)
        alone = [getattr(material, name)(law, s) for s in states]
        assert np.allclose(many, alone, rtol=1e-14)
