"""Keys about pruning of an object that do not go together."""


def validate_pruning(raw: dict, sources: list[str]) -> list[tuple[tuple, str]]:
    """Return (path, message) for keys about pruning that do not go together."""
    mode, errors = raw.get("prune", "off"), []
    if mode != "off" and sources == ["shape"]:
        errors.append((("prune",), "is only for objects made of gaussians or a mesh"))
    if mode == "versagauss" and "prune_scale" not in raw:
        errors.append((("prune",), "needs prune_scale: VersaGauss keeps shares by a volume scale"))
    if "prune_scale" in raw and mode != "versagauss" and raw.get("prune") != "off":
        errors.append((("prune_scale",), 'is only for prune = "versagauss"'))
    if mode == "off" and raw.get("passive_gaussians") is True:
        errors.append(
            (
                ("passive_gaussians",),
                'needs prune = "auto" or "versagauss": what is pruned rides along',
            )
        )
    if "volume_fraction_profile" in raw and raw.get("passive_gaussians") is True:
        errors.append((("passive_gaussians",), "is not for objects with a volume_fraction_profile"))
    return errors
