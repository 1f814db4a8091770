"""What objects may be made of: names of things, and what a scene has for them.

Stiffness is for the eye: ceramics and wood are as soft as rubber here, so that steps are long.
"""

import re
from typing import Any, NamedTuple

from vgmpi import materials
from vgmpi.misspelt import nearest

Keys = dict[str, Any]
USUAL = "rubber"


class Stuff(NamedTuple):
    """keys: of the scene's material. words: names of things that are made of it."""

    keys: Keys
    words: str


def _hard(density: float, stiffness: float, friction: float = 0.4) -> Keys:
    return {
        "kind": "elastic", "density": density, "youngs_modulus": stiffness, "poisson_ratio": 0.3,
        "friction": friction,
    }  # fmt: skip


def _liquid(preset: str, speed: float = 3.0) -> Keys:
    return {"kind": "fluid", "preset": preset, "max_speed": speed}


STUFF = {
    "water": Stuff(
        _liquid("water"),
        "water milk coffee tea espresso juice wine beer lemonade soup cola cocoa drink puddle",
    ),
    "honey": Stuff(_liquid("honey"), "honey syrup caramel"),
    "oil": Stuff(_liquid("oil"), "oil"),
    "rubber": Stuff(
        _hard(1000, 2e5, 0.6), "rubber ball duck toy tyre tire balloon eraser boot rocket"
    ),
    "ceramic": Stuff(
        _hard(2300, 2e6),
        "ceramic cup mug plate bowl vase pot saucer teapot porcelain dish tile glass bottle jar",
    ),
    "wood": Stuff(
        _hard(600, 1e6),
        "wood wooden box table block chair guitar crate pencil stool shelf board drum die",
    ),
    "paper": Stuff(_hard(700, 3e5), "paper book card cardboard carton parcel"),
    "metal": Stuff(_hard(7800, 4e6), "spoon fork knife key can pan kettle coin hammer car"),
    "stone": Stuff(_hard(2600, 4e6, 0.6), "stone rock brick pebble marble statue"),
    "fruit": Stuff(
        _hard(900, 3e5), "fruit apple orange lemon pear tomato plum peach banana melon potato"
    ),
    "flesh": Stuff(_hard(1000, 1e5, 0.6), "cat dog bear person teddy doll animal bird horse"),
    "bread": Stuff(_hard(300, 5e4, 0.6), "bread cake toast sponge bun cookie muffin croissant"),
    "jelly": Stuff({"kind": "elastic", "preset": "jelly"}, "jelly pudding gummy"),
    "clay": Stuff({"kind": "plasticine", "preset": "plasticine"}, "clay plasticine dough putty"),
    "cream": Stuff({"kind": "foam", "preset": "whipped cream"}, "cream foam meringue icecream"),
    "sand": Stuff({"kind": "sand", "youngs_modulus": 1e6}, "sand sandcastle sugar salt castle"),
    "snow": Stuff({"kind": "snow", "preset": "packed snow"}, "snow snowball snowman"),
    "ketchup": Stuff({"kind": "paste", "preset": "ketchup"}, "ketchup sauce mustard"),
}
_WORDS = {word: name for name, one in STUFF.items() for word in one.words.split()}


def known() -> list[str]:
    """All names that a layout's `material` may have."""
    presets = [name for table in materials.registry.values() for name in table.presets]  # type: ignore[attr-defined]
    return list(dict.fromkeys([*STUFF, *presets]))


def keys(name: str) -> Keys:
    """The keys of the scene's material for a name of ours, of a preset, or of a thing that is known
    to be of one. Raises ValueError."""
    if name in STUFF:
        return dict(STUFF[name].keys)
    for kind, table in materials.registry.items():
        if name in table.presets:  # type: ignore[attr-defined]
            more = {"max_speed": 3.0} if kind == "fluid" else {}
            return {"kind": "elastic" if kind == "corotated" else kind, "preset": name, **more}
    if name in _WORDS:
        return dict(STUFF[_WORDS[name]].keys)
    names = known()
    raise ValueError(f"no such material{nearest(name, names)}; known: {', '.join(names)}")


def words() -> list[str]:
    """Names of things of which it is known what they are made of."""
    return list(_WORDS)


def ranked(ranks: list[tuple[str, float]]) -> tuple[str, str]:
    """What an object is made of by things that it looks like, the likeliest first, and why."""
    likely = ", ".join(f"{word} {share:.2f}" for word, share in ranks[:3])
    return _WORDS[ranks[0][0]], f"looks like {likely}"


def guessed(name: str, text: str | None) -> tuple[str, str]:
    """What an object is made of by its name and by what is said of it, and the reason."""
    told = [word for word in re.findall(r"[a-z]+", f"{text or ''} {name}".lower())]
    for word in told:
        for one in (word, word.removesuffix("s")):
            if one in STUFF:
                return one, f"'{word}' is a material"
            if one in _WORDS:
                return _WORDS[one], f"'{word}' is usually of it"
    return USUAL, f"no word of '{name}' is known: only the usual one"
