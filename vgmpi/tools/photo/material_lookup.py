"""Materials of objects: words for objects and the scene keys of their materials.

Stiffness is visual only: ceramics and wood are as soft as rubber here, so that time steps are long.
"""

import re
from typing import Any, NamedTuple

from vgmpi import materials
from vgmpi.runtime.message_text import did_you_mean

Keys = dict[str, Any]
FALLBACK = "rubber"


class MaterialEntry(NamedTuple):
    """Material of the table."""

    keys: Keys  # keys of the material in the scene
    words: str  # names of objects made of it


def _hard(density: float, stiffness: float, friction: float = 0.4) -> Keys:
    """Return the keys of an elastic material: density [kg/m^3], Young's modulus [Pa], friction."""
    return {
        "kind": "elastic", "density": density, "youngs_modulus": stiffness, "poisson_ratio": 0.3,
        "friction": friction,
    }  # fmt: skip


def _liquid(preset: str, speed: float = 3.0) -> Keys:
    """Return the keys of a fluid preset with its largest speed [m/s]."""
    return {"kind": "fluid", "preset": preset, "max_speed": speed}


MATERIALS = {
    "water": MaterialEntry(
        _liquid("water"),
        "water milk coffee tea espresso juice wine beer lemonade soup cola cocoa drink puddle",
    ),
    "honey": MaterialEntry(_liquid("honey"), "honey syrup caramel"),
    "oil": MaterialEntry(_liquid("oil"), "oil"),
    "rubber": MaterialEntry(
        _hard(1000, 2e5, 0.6), "rubber ball duck toy tyre tire balloon eraser boot rocket"
    ),
    "ceramic": MaterialEntry(
        _hard(2300, 2e6),
        "ceramic cup mug plate bowl vase pot saucer teapot porcelain dish tile glass bottle jar",
    ),
    "wood": MaterialEntry(
        _hard(600, 1e6),
        "wood wooden box table block chair guitar crate pencil stool shelf board drum die",
    ),
    "paper": MaterialEntry(_hard(700, 3e5), "paper book card cardboard carton parcel"),
    "metal": MaterialEntry(_hard(7800, 4e6), "spoon fork knife key can pan kettle coin hammer car"),
    "stone": MaterialEntry(_hard(2600, 4e6, 0.6), "stone rock brick pebble marble statue"),
    "fruit": MaterialEntry(
        _hard(900, 3e5), "fruit apple orange lemon pear tomato plum peach banana melon potato"
    ),
    "flesh": MaterialEntry(
        _hard(1000, 1e5, 0.6), "cat dog bear person teddy doll animal bird horse"
    ),
    "bread": MaterialEntry(
        _hard(300, 5e4, 0.6), "bread cake toast sponge bun cookie muffin croissant"
    ),
    "jelly": MaterialEntry({"kind": "elastic", "preset": "jelly"}, "jelly pudding gummy"),
    "clay": MaterialEntry(
        {"kind": "plasticine", "preset": "plasticine"}, "clay plasticine dough putty"
    ),
    "cream": MaterialEntry(
        {"kind": "foam", "preset": "whipped cream"}, "cream foam meringue icecream"
    ),
    "sand": MaterialEntry(
        {"kind": "sand", "youngs_modulus": 1e6}, "sand sandcastle sugar salt castle"
    ),
    "snow": MaterialEntry({"kind": "snow", "preset": "packed snow"}, "snow snowball snowman"),
    "ketchup": MaterialEntry({"kind": "paste", "preset": "ketchup"}, "ketchup sauce mustard"),
}
_WORDS = {word: name for name, entry in MATERIALS.items() for word in entry.words.split()}


def material_names() -> list[str]:
    """Return all names that the key `material` of a layout may have."""
    presets = [name for table in materials.registry.values() for name in table.presets]
    return list(dict.fromkeys([*MATERIALS, *presets]))


def material_keys(name: str) -> Keys:
    """Return the scene keys of a material by its name, by a preset or by an object word.

    Raises:
        ValueError: The name is unknown.
    """
    if name in MATERIALS:
        return dict(MATERIALS[name].keys)
    for kind, table in materials.registry.items():
        if name in table.presets:  # type: ignore[attr-defined]
            more = {"max_speed": 3.0} if kind == "fluid" else {}
            return {"kind": "elastic" if kind == "corotated" else kind, "preset": name, **more}
    if name in _WORDS:
        return dict(MATERIALS[_WORDS[name]].keys)
    names = material_names()
    raise ValueError(f"no such material{did_you_mean(name, names)}; known: {', '.join(names)}")


def words() -> list[str]:
    """Return the object words whose material is in the table."""
    return list(_WORDS)


def guess_from_ranking(ranks: list[tuple[str, float]]) -> tuple[str, str]:
    """Return a material and the reason from words with probabilities, the likeliest first."""
    likely = ", ".join(f"{word} {probability:.2f}" for word, probability in ranks[:3])
    return _WORDS[ranks[0][0]], f"looks like {likely}"


def guess_from_name(name: str, text: str | None) -> tuple[str, str]:
    """Return a material and the reason from the name and the description of an object."""
    tokens = [word for word in re.findall(r"[a-z]+", f"{text or ''} {name}".lower())]
    for word in tokens:
        for candidate in (word, word.removesuffix("s")):
            if candidate in MATERIALS:
                return candidate, f"'{word}' is a material"
            if candidate in _WORDS:
                return _WORDS[candidate], f"'{word}' is usually of it"
    return FALLBACK, f"no word of '{name}' is known: only the usual one"
