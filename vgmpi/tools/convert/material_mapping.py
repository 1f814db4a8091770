"""Conversion of materials.

Their laws are in mpm_solver_warp/mpm_utils.py of each program. Their von Mises laws bound the size
of the stress deviator, |s| <= yield_stress, ours the stress in tension, sqrt(3/2) |s|; their
plastic flow is a norm of strains too, of which the strain in tension is sqrt(2/3).
"""

import math
from typing import Any

from . import source_schema
from .config_reader import Body, Config, Report, key_error

Table = dict[str, Any]
IN_TENSION = math.sqrt(1.5)  # [-] stress in tension per norm of its deviator
RESIDUAL_YIELD_FRACTION = 0.01  # [-] residual yield stress of plasticine at full damage
PLASTIC = ("yield_stress", "hardening", "xi", "softening", "plastic_viscosity")
# Keys that each law reads besides `material`, `density` and keys outside the law.
KEYS_READ = {
    "jelly": ("E", "nu"),
    "metal": ("E", "nu", "yield_stress", "hardening", "xi"),
    "sand": ("E", "nu", "friction_angle", "porosity", "permeability"),
    "foam": ("E", "nu", "yield_stress", "plastic_viscosity"),
    "snow": ("E", "nu", "compression", "stretch", "hardening_coe"),
    "plasticine": ("E", "nu", "yield_stress", "softening", "hardening", "xi"),
    "fluid": ("bulk_modulus", "gamma", "diff_coe", "porosity", "permeability"),
    "jam": ("bulk_modulus", "gamma"),
}
LAW_KEYS = tuple(dict.fromkeys(key for read in KEYS_READ.values() for key in read))
# VersaGauss has one value of these for all bodies.
KEYS_SHARED_BY_BODIES = (
    "hardening", "porosity", "permeability", "compression", "stretch", "gamma", "hardening_coe",
    "friction_angle",
)  # fmt: skip


def effective_value(config: Config, k: int, key: str) -> Any:
    """Return the value of a key of body k that their program computes with."""
    laws = [body.law for body in config.bodies]
    if not config.is_versagauss or key not in KEYS_SHARED_BY_BODIES:
        return getattr(laws[k], key)
    if key == "gamma":  # its reader fills in the default of each body
        return laws[-1].gamma  # type: ignore[attr-defined]
    owners = [law for law in laws if law.has_key(key)]
    return getattr(owners[-1] if owners else laws[k], key)


def material_table(config: Config, k: int, report: Report) -> Table:
    """Return the [material.*] table of body k; keys that it lacks go into the report.

    Raises ConvertError if a key that the law needs is missing.
    """
    body = config.bodies[k]
    kind = body.law.material  # type: ignore[attr-defined]
    _report_unused(config, body, kind, report)
    for key in KEYS_SHARED_BY_BODIES if config.is_versagauss else ():
        if body.law.has_key(key) and key in KEYS_READ[kind] and key in body.law.model_fields_set:
            value = effective_value(config, k, key)
            if value != getattr(body.law, key):
                reason = f"their program has one for all bodies, {value:g}, which is taken"
                report.approximated((*body.law_path, key), getattr(body.law, key), reason)
    table = {
        "jelly": _jelly, "metal": _metal, "sand": _sand, "foam": _foam, "snow": _snow,
        "plasticine": _plasticine, "fluid": _fluid, "jam": _fluid,
    }[kind](config, k, report)  # fmt: skip
    return table


def report_rigid_body(body: Body, report: Report) -> None:
    """Report the keys that a static body does not need."""
    reason = "it is scenery that others collide with; theirs slows what shares a node with it"
    report.approximated((*body.law_path, "static"), True, reason)
    if getattr(body.law, "static_inf", False):
        report.dropped(
            (*body.law_path, "static_inf"), True, "colliders do not hold fast what meets them"
        )
    reason = "the body is held (static): it is scenery here, which has no material"
    numbers = ("material", "density", *LAW_KEYS, *PLASTIC, "rpic_damping", "pic_damping")
    for key in dict.fromkeys((*numbers, "additional_material_params")):
        if body.law.has_key(key):
            report.dropped((*body.law_path, key), getattr(body.law, key), reason)


def _report_unused(config: Config, body: Body, kind: str, report: Report) -> None:
    """Report keys that a law does not use."""
    program = "VersaGauss" if config.is_versagauss else "PhysGaussian"
    for key in LAW_KEYS:
        if key in KEYS_READ[kind] or not body.law.has_key(key):
            continue
        if key in type(body.law).model_fields:
            reason = f"{program} has no use of it in {kind!r}"
            report.dropped((*body.law_path, key), getattr(body.law, key), reason)
    for key in ("softening", "plastic_viscosity") if config.is_versagauss else ():
        if key in KEYS_READ[kind] and body.law.has_key(key):
            reason = "VersaGauss reads it and computes without it"
            report.dropped((*body.law_path, key), getattr(body.law, key), reason)
    if body.law.has_key("static_inf"):
        reason = "the body is not static"
        report.dropped((*body.law_path, "static_inf"), body.law.static_inf, reason)  # type: ignore[attr-defined]
    if body.law.has_key("pic_damping"):
        reason = f"{program} reads it and computes without it"
        report.dropped((*body.law_path, "pic_damping"), body.law.pic_damping, reason)


def _elastic(law: source_schema.Law, kind: str) -> Table:
    """Return the keys of an elastic law."""
    return {
        "kind": kind,
        "density": law.density,
        "youngs_modulus": law.E,
        "poisson_ratio": law.nu,
    }


def _jelly(config: Config, k: int, report: Report) -> Table:
    """Return the table of jelly."""
    return _elastic(config.bodies[k].law, "corotated")


def _hardening(config: Config, k: int) -> float:
    """Return the growth of |s| per norm of plastic strain [Pa]."""
    law = config.bodies[k].law
    is_always_on = config.is_versagauss and law.material == "plasticine"  # type: ignore[attr-defined]
    is_on = is_always_on or effective_value(config, k, "hardening") == 1
    return 2 * _mu(law) * law.xi if is_on else 0.0


def _mu(law: source_schema.Law) -> float:
    """Return the shear modulus [Pa]."""
    return law.E / (2 * (1 + law.nu))


def _report_hencky(config: Config, k: int, report: Report, description: str) -> None:
    """Report that a law agrees with Hencky's for small elastic strains only."""
    body = config.bodies[k]
    reason = f"{description}; alike for small elastic strains"
    report.approximated((*body.law_path, "material"), body.law.material, reason)  # type: ignore[attr-defined]


def _report_hardening_flag(config: Config, k: int, report: Report) -> None:
    """Report hardening keys that have no effect: `hardening` is a switch that only 1 turns on."""
    body = config.bodies[k]
    if effective_value(config, k, "hardening") == 1:
        return
    reason = "hardening is a switch there, on with 1 only: nothing hardens"
    for key in ("hardening", "xi"):
        if body.law.has_key(key):
            report.dropped((*body.law_path, key), getattr(body.law, key), reason)


def _metal(config: Config, k: int, report: Report) -> Table:
    """Return the table of metal."""
    body = config.bodies[k]
    if not body.law.yield_stress > 0:
        message = "must be > 0 for metal: with 0, the default, theirs bears no shear at all; got 0"
        raise key_error(config.path, (*body.law_path, "yield_stress"), message)
    _report_hardening_flag(config, k, report)
    _report_hencky(config, k, report, "theirs multiplies Hencky's stress by the stretches")
    return _elastic(body.law, "metal") | {
        "yield_stress": IN_TENSION * body.law.yield_stress,
        "hardening_modulus": IN_TENSION**2 * _hardening(config, k),
    }


def _sand(config: Config, k: int, report: Report) -> Table:
    """Return the table of sand."""
    body = config.bodies[k]
    porosity = effective_value(config, k, "porosity") if config.is_versagauss else 0.0
    reason = "sand that has opened closes here before it presses; theirs does not count what opens"
    report.approximated((*body.law_path, "material"), "sand", reason)
    table = _elastic(body.law, "sand") | {
        "porosity": porosity,
        "friction_angle": f"{effective_value(config, k, 'friction_angle'):.12g} deg",
        "friction_angle_test": "triaxial",
    }
    return table | {"density": body.law.density / (1 - porosity)}  # theirs is the bulk density


def _foam(config: Config, k: int, report: Report) -> Table:
    """Return the table of foam."""
    body = config.bodies[k]
    viscosity = 0.0 if config.is_versagauss else body.law.plastic_viscosity
    if not body.law.yield_stress > 0 and not viscosity > 0:
        message = (
            "must be > 0 for foam that has no plastic_viscosity: theirs bears no shear then; got 0"
        )
        raise key_error(config.path, (*body.law_path, "yield_stress"), message)
    _report_hencky(config, k, report, "theirs multiplies Hencky's stress by the stretches")
    if (
        not viscosity > 0
    ):  # it flows at once: |s| <= sqrt(2/3) yield_stress is that stress in tension
        return _elastic(body.law, "metal") | {"yield_stress": body.law.yield_stress}
    # In simple shear |s| = sqrt(2) tau and the norm of the plastic strain rate is rate / sqrt(2).
    return _elastic(body.law, "foam") | {
        "yield_stress": body.law.yield_stress / math.sqrt(3),
        "viscosity": viscosity / 2,
    }


def _snow(config: Config, k: int, report: Report) -> Table:
    """Return the table of snow."""
    body = config.bodies[k]
    key_path = (*body.law_path, "material")
    table = _elastic(body.law, "snow")
    if not config.is_versagauss:
        reason = (
            "PhysGaussian computes no stress for snow: it is ours with E and nu, and our defaults"
        )
        report.approximated(key_path, "snow", reason)
        return table
    reason = (
        "the factor by which it hardens stays between 1 / 20 and 20 here (max_hardening_factor)"
    )
    report.approximated(key_path, "snow", reason)
    return table | {
        "critical_compression": effective_value(config, k, "compression"),
        "critical_stretch": effective_value(config, k, "stretch"),
        "hardening_coefficient": effective_value(config, k, "hardening_coe"),
    }


def _plasticine(config: Config, k: int, report: Report) -> Table:
    """Return the table of plasticine."""
    body = config.bodies[k]
    strength = IN_TENSION * body.law.yield_stress
    if strength == 0:  # theirs then never yields
        for key in PLASTIC:
            is_reported = config.is_versagauss and key in ("softening", "plastic_viscosity")
            if body.law.has_key(key) and key in KEYS_READ["plasticine"] and not is_reported:
                reason = "without a yield_stress theirs never yields"
                report.dropped((*body.law_path, key), getattr(body.law, key), reason)
        return _elastic(body.law, "corotated")
    description = "theirs is fixed corotated below the yield stress"
    if config.is_versagauss:
        description += ", and lowers one for all its particles"
        if body.law.has_key("hardening"):
            reason = "VersaGauss hardens plasticine by xi, whatever it is"
            report.dropped((*body.law_path, "hardening"), body.law.hardening, reason)
    else:
        _report_hardening_flag(config, k, report)
    _report_hencky(config, k, report, description)
    softening = 0.1 if config.is_versagauss else body.law.softening
    key_path = (*body.law_path, "softening")
    softening_rate = softening - _hardening(config, k)  # decrease of |s| per norm of plastic strain
    if softening_rate <= 0:
        table = _elastic(body.law, "metal") | {"yield_stress": strength}
        return table | {"hardening_modulus": -(IN_TENSION**2) * softening_rate}
    table = _elastic(body.law, "plasticine") | {"yield_stress": strength}
    if softening_rate >= 0.99 * _mu(body.law):
        reason = "it would fall faster than it can be unloaded; the yield stress stays as it is"
        report.dropped(key_path, softening, reason)
        return table
    if body.law.has_key("softening") and not config.is_versagauss:
        reason = (
            "the yield stress falls at their pace to 1 % and stays; theirs then loses all stiffness"
        )
        report.approximated(key_path, softening, reason)
    return table | {
        "residual_yield_stress": RESIDUAL_YIELD_FRACTION * strength,
        "softening_strain": (1 - RESIDUAL_YIELD_FRACTION)
        * strength
        / (IN_TENSION**2 * softening_rate),
    }


def _fluid(config: Config, k: int, report: Report) -> Table:
    """Return the table of a fluid."""
    body = config.bodies[k]
    if body.law.bulk_modulus is None:  # type: ignore[attr-defined]
        message = "required key is missing: without it theirs has no pressure"
        raise key_error(config.path, (*body.law_path, "bulk_modulus"), message)
    return {
        "kind": "fluid",
        "density": body.law.density,
        "tait_coefficient": body.law.bulk_modulus,  # type: ignore[attr-defined]
        "tait_exponent": effective_value(config, k, "gamma"),
    }


def coupling_tables(config: Config, names: list[str | None], report: Report) -> list[Table]:
    """Return the couplings between bodies of VersaGauss.

    names: materials of the bodies here, None for a body without.
    """
    if not config.is_versagauss:
        return []
    tables: list[Table] = []
    bodies = [(k, names[k], body.law.material) for k, body in enumerate(config.bodies)]  # type: ignore[attr-defined]
    fluids = [(k, name) for k, name, kind in bodies if kind == "fluid" and name]
    rates = {config.bodies[k].law.diff_coe for k, _ in fluids}  # type: ignore[attr-defined]
    reported = [k for k, _ in fluids if config.bodies[k].law.has_key("diff_coe")]
    if len(fluids) > 1 and len(rates) == 1 and max(rates) > 0:
        tables += [
            {"between": [a, b], "kind": "mixing", "diffusivity": max(rates)}
            for i, (_, a) in enumerate(fluids) for _, b in fluids[i + 1 :]
        ]  # fmt: skip
    elif max(rates, default=0.0) > 0:
        reason_mixing = (
            "there is one fluid only" if len(fluids) < 2 else "fluids that mix have one here"
        )
        for k in reported:
            body = config.bodies[k]
            report.dropped((*body.law_path, "diff_coe"), body.law.diff_coe, reason_mixing)  # type: ignore[attr-defined]
    sands = [name for _, name, kind in bodies if kind == "sand" and name]
    permeability = effective_value(config, 0, "permeability")
    owners = [body for body in config.bodies if body.law.has_key("permeability")]
    for body in owners:
        key_path, value = (*body.law_path, "permeability"), body.law.permeability  # type: ignore[attr-defined]
        if not (fluids and sands):
            report.dropped(
                key_path, value, "it is between a fluid and a sand, which are not both there"
            )
        elif body is owners[-1]:
            reason = (
                "it is the hydraulic conductivity here; their drag m m c has no consistent unit"
            )
            report.approximated(key_path, value, reason)
    if owners:
        tables += [
            {"between": [fluid, sand], "kind": "drag", "hydraulic_conductivity": permeability}
            for _, fluid in fluids for sand in sands
        ]  # fmt: skip
    return tables
