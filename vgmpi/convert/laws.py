"""Their materials as tables of ours.

What is theirs stands in mpm_solver_warp/mpm_utils.py of each. Their von Mises laws bound the size
of the stress deviator, |s| <= yield_stress, ours the stress in tension, sqrt(3/2) |s|; their
plastic flow is a size of strains too, of which the strain in tension is sqrt(2/3).
"""

import math
from typing import Any

from vgmpi.convert import keys
from vgmpi.convert.reading import Body, Config, Report, refused

Table = dict[str, Any]
IN_TENSION = math.sqrt(1.5)  # stress in tension per size of its deviator
LEFT = 0.01  # of the yield stress of plasticine, at full damage
ELASTIC = ("E", "nu", "density")
PLASTIC = ("yield_stress", "hardening", "xi", "softening", "plastic_viscosity")
# beside `material`, `density` and what is no matter of the law
READ = {
    "jelly": ("E", "nu"),
    "metal": ("E", "nu", "yield_stress", "hardening", "xi"),
    "sand": ("E", "nu", "friction_angle", "porosity", "permeability"),
    "foam": ("E", "nu", "yield_stress", "plastic_viscosity"),
    "snow": ("E", "nu", "compression", "stretch", "hardening_coe"),
    "plasticine": ("E", "nu", "yield_stress", "softening", "hardening", "xi"),
    "fluid": ("bulk_modulus", "gamma", "diff_coe", "porosity", "permeability"),
    "jam": ("bulk_modulus", "gamma"),
}
OF_LAWS = tuple(dict.fromkeys(key for read in READ.values() for key in read))
# VersaGauss keeps one of these for all bodies
SHARED = (
    "hardening", "porosity", "permeability", "compression", "stretch", "gamma", "hardening_coe",
    "friction_angle",
)  # fmt: skip


def effective(config: Config, k: int, key: str) -> Any:
    """What their program computes with, of a key of body k."""
    laws = [body.law for body in config.bodies]
    if not config.several or key not in SHARED:
        return getattr(laws[k], key)
    if key == "gamma":  # its reader fills in the default of each body
        return laws[-1].gamma  # type: ignore[attr-defined]
    given = [law for law in laws if law.given(key)]
    return getattr(given[-1] if given else laws[k], key)


def material(config: Config, k: int, report: Report) -> Table:
    """The [material.*] table of body k; what it lacks goes into the report. Raises ConvertError
    where a key that the law needs is missing."""
    body = config.bodies[k]
    kind = body.law.material  # type: ignore[attr-defined]
    _tell_unused(config, body, kind, report)
    for key in SHARED if config.several else ():
        if body.law.given(key) and key in READ[kind] and key in body.law.model_fields_set:
            counts = effective(config, k, key)
            if counts != getattr(body.law, key):
                why = f"their program has one for all bodies, {counts:g}, which is taken"
                report.partly((*body.law_at, key), getattr(body.law, key), why)
    out = {
        "jelly": _jelly, "metal": _metal, "sand": _sand, "foam": _foam, "snow": _snow,
        "plasticine": _plasticine, "fluid": _fluid, "jam": _fluid,
    }[kind](config, k, report)  # fmt: skip
    return out


def held(body: Body, report: Report) -> None:
    """Name what a body that is only held does not need."""
    why = "it is scenery that others collide with; theirs slows what shares a node with it"
    report.partly((*body.law_at, "static"), True, why)
    if getattr(body.law, "static_inf", False):
        report.lost(
            (*body.law_at, "static_inf"), True, "colliders do not hold fast what meets them"
        )
    why = "the body is held (static): it is scenery here, which has no material"
    numbers = ("material", "density", *OF_LAWS, *PLASTIC, "rpic_damping", "pic_damping")
    for key in dict.fromkeys((*numbers, "additional_material_params")):
        if body.law.given(key):
            report.lost((*body.law_at, key), getattr(body.law, key), why)


def _tell_unused(config: Config, body: Body, kind: str, report: Report) -> None:
    theirs = "VersaGauss" if config.several else "PhysGaussian"
    for key in OF_LAWS:
        if key in READ[kind] or not body.law.given(key):
            continue
        if key in type(body.law).model_fields:
            why = f"{theirs} has no use of it in {kind!r}"
            report.lost((*body.law_at, key), getattr(body.law, key), why)
    for key in ("softening", "plastic_viscosity") if config.several else ():
        if key in READ[kind] and body.law.given(key):
            why = "VersaGauss reads it and computes without it"
            report.lost((*body.law_at, key), getattr(body.law, key), why)
    if body.law.given("static_inf"):
        why = "the body is not static"
        report.lost((*body.law_at, "static_inf"), body.law.static_inf, why)  # type: ignore[attr-defined]
    if body.law.given("pic_damping"):
        why = f"{theirs} reads it and computes without it"
        report.lost((*body.law_at, "pic_damping"), body.law.pic_damping, why)


def _elastic(law: keys.Law, kind: str) -> Table:
    return {
        "kind": kind,
        "density": law.density,
        "youngs_modulus": law.E,
        "poisson_ratio": law.nu,
    }


def _jelly(config: Config, k: int, report: Report) -> Table:
    return _elastic(config.bodies[k].law, "corotated")


def _hardening(config: Config, k: int) -> float:
    """[Pa] Growth of |s| per size of plastic strain."""
    law = config.bodies[k].law
    always = config.several and law.material == "plasticine"  # type: ignore[attr-defined]
    on = always or effective(config, k, "hardening") == 1
    return 2 * _mu(law) * law.xi if on else 0.0


def _mu(law: keys.Law) -> float:
    return law.E / (2 * (1 + law.nu))


def _tell_of_hencky(config: Config, k: int, report: Report, theirs: str) -> None:
    body = config.bodies[k]
    why = f"{theirs}; alike for small elastic strains"
    report.partly((*body.law_at, "material"), body.law.material, why)  # type: ignore[attr-defined]


def _tell_of_flag(config: Config, k: int, report: Report) -> None:
    """`hardening` is a switch: unless it is 1 it does nothing, and neither does xi."""
    body = config.bodies[k]
    if effective(config, k, "hardening") == 1:
        return
    why = "hardening is a switch there, on with 1 only: nothing hardens"
    for key in ("hardening", "xi"):
        if body.law.given(key):
            report.lost((*body.law_at, key), getattr(body.law, key), why)


def _metal(config: Config, k: int, report: Report) -> Table:
    body = config.bodies[k]
    if not body.law.yield_stress > 0:
        said = "must be > 0 for metal: with 0, the default, theirs bears no shear at all; got 0"
        raise refused(config.path, (*body.law_at, "yield_stress"), said)
    _tell_of_flag(config, k, report)
    _tell_of_hencky(config, k, report, "theirs multiplies Hencky's stress by the stretches")
    return _elastic(body.law, "metal") | {
        "yield_stress": IN_TENSION * body.law.yield_stress,
        "hardening": IN_TENSION**2 * _hardening(config, k),
    }


def _sand(config: Config, k: int, report: Report) -> Table:
    body = config.bodies[k]
    porosity = effective(config, k, "porosity") if config.several else 0.0
    why = "sand that has opened closes here before it presses; theirs does not count what opens"
    report.partly((*body.law_at, "material"), "sand", why)
    out = _elastic(body.law, "sand") | {
        "porosity": porosity,
        "friction_angle": f"{effective(config, k, 'friction_angle'):.12g} deg",
        "match": "triaxial",
    }
    return out | {"density": body.law.density / (1 - porosity)}  # theirs is that of the bulk


def _foam(config: Config, k: int, report: Report) -> Table:
    body = config.bodies[k]
    viscosity = 0.0 if config.several else body.law.plastic_viscosity
    if not body.law.yield_stress > 0 and not viscosity > 0:
        said = (
            "must be > 0 for foam that has no plastic_viscosity: theirs bears no shear then; got 0"
        )
        raise refused(config.path, (*body.law_at, "yield_stress"), said)
    _tell_of_hencky(config, k, report, "theirs multiplies Hencky's stress by the stretches")
    if not viscosity > 0:  # flows at once: |s| <= sqrt(2/3) yield_stress is that stress in tension
        return _elastic(body.law, "metal") | {"yield_stress": body.law.yield_stress}
    # in simple shear |s| = sqrt(2) tau and the plastic strains' size is the rate / sqrt(2)
    return _elastic(body.law, "foam") | {
        "yield_stress": body.law.yield_stress / math.sqrt(3),
        "viscosity": viscosity / 2,
    }


def _snow(config: Config, k: int, report: Report) -> Table:
    body = config.bodies[k]
    at = (*body.law_at, "material")
    out = _elastic(body.law, "snow")
    if not config.several:
        why = "PhysGaussian computes no stress for snow: it is ours with E and nu, and our defaults"
        report.partly(at, "snow", why)
        return out
    why = "the factor by which it hardens stays between 1 / 20 and 20 here (hardening_limit)"
    report.partly(at, "snow", why)
    return out | {
        "critical_compression": effective(config, k, "compression"),
        "critical_stretch": effective(config, k, "stretch"),
        "hardening": effective(config, k, "hardening_coe"),
    }


def _plasticine(config: Config, k: int, report: Report) -> Table:
    body = config.bodies[k]
    strength = IN_TENSION * body.law.yield_stress
    if strength == 0:  # theirs then never yields
        for key in PLASTIC:
            told = config.several and key in ("softening", "plastic_viscosity")
            if body.law.given(key) and key in READ["plasticine"] and not told:
                why = "without a yield_stress theirs never yields"
                report.lost((*body.law_at, key), getattr(body.law, key), why)
        return _elastic(body.law, "corotated")
    theirs = "theirs is fixed corotated below the yield stress"
    if config.several:
        theirs += ", and lowers one for all its particles"
        if body.law.given("hardening"):
            why = "VersaGauss hardens plasticine by xi, whatever it is"
            report.lost((*body.law_at, "hardening"), body.law.hardening, why)
    else:
        _tell_of_flag(config, k, report)
    _tell_of_hencky(config, k, report, theirs)
    softening = 0.1 if config.several else body.law.softening
    at = (*body.law_at, "softening")
    fall = softening - _hardening(config, k)  # of |s| per size of plastic strain
    if fall <= 0:
        out = _elastic(body.law, "metal") | {"yield_stress": strength}
        return out | {"hardening": -(IN_TENSION**2) * fall}
    out = _elastic(body.law, "plasticine") | {"yield_stress": strength}
    if fall >= 0.99 * _mu(body.law):
        why = "it would fall faster than it can be unloaded; the yield stress stays as it is"
        report.lost(at, softening, why)
        return out
    if body.law.given("softening") and not config.several:
        why = (
            "the yield stress falls at their pace to 1 % and stays; theirs then loses all stiffness"
        )
        report.partly(at, softening, why)
    return out | {
        "residual_stress": LEFT * strength,
        "softening_strain": (1 - LEFT) * strength / (IN_TENSION**2 * fall),
    }


def _fluid(config: Config, k: int, report: Report) -> Table:
    body = config.bodies[k]
    if body.law.bulk_modulus is None:  # type: ignore[attr-defined]
        said = "required key is missing: without it theirs has no pressure"
        raise refused(config.path, (*body.law_at, "bulk_modulus"), said)
    return {
        "kind": "fluid",
        "density": body.law.density,
        "bulk_modulus": body.law.bulk_modulus,  # type: ignore[attr-defined]
        "gamma": effective(config, k, "gamma"),
    }


def couplings(config: Config, names: list[str | None], report: Report) -> list[Table]:
    """What acts between two bodies of VersaGauss. names: of their materials here, None for one
    that has none."""
    if not config.several:
        return []
    found: list[Table] = []
    of = [(k, names[k], body.law.material) for k, body in enumerate(config.bodies)]  # type: ignore[attr-defined]
    fluids = [(k, name) for k, name, kind in of if kind == "fluid" and name]
    rates = {config.bodies[k].law.diff_coe for k, _ in fluids}  # type: ignore[attr-defined]
    told = [k for k, _ in fluids if config.bodies[k].law.given("diff_coe")]
    if len(fluids) > 1 and len(rates) == 1 and max(rates) > 0:
        found += [
            {"between": [a, b], "kind": "mixing", "diffusion": max(rates)}
            for i, (_, a) in enumerate(fluids) for _, b in fluids[i + 1 :]
        ]  # fmt: skip
    elif max(rates, default=0.0) > 0:
        one = "there is one fluid only" if len(fluids) < 2 else "fluids that mix have one here"
        for k in told:
            body = config.bodies[k]
            report.lost((*body.law_at, "diff_coe"), body.law.diff_coe, one)  # type: ignore[attr-defined]
    sands = [name for _, name, kind in of if kind == "sand" and name]
    permeability = effective(config, 0, "permeability")
    givers = [body for body in config.bodies if body.law.given("permeability")]
    for body in givers:
        at, value = (*body.law_at, "permeability"), body.law.permeability  # type: ignore[attr-defined]
        if not (fluids and sands):
            report.lost(at, value, "it is between a fluid and a sand, which are not both there")
        elif body is givers[-1]:
            why = "it is the hydraulic conductivity here; their drag m m c has no consistent unit"
            report.partly(at, value, why)
    if givers:
        found += [
            {"between": [fluid, sand], "kind": "drag", "permeability": permeability}
            for _, fluid in fluids for sand in sands
        ]  # fmt: skip
    return found
