"""A tank of water whose floor is a thick plate with an opening, in cells of 1 cm."""

DX, PLATE = 0.01, 3  # [m] cell, [cells] thickness of the floor
SCENE = """
[accuracy]
pressure = "explicit"
precision = "{precision}"
[domain]
size = [{wide}, {deep}, {high}]
cell = 0.01
gravity = [0, 0, -9.8]
boundary = {{ default = "slip", bottom = "open" }}
[time]
end = {end}
[material.water]
kind = "fluid"
max_depth = {head}
[[object]]
name = "water"
material = "water"
shape = {{ box = [[0, 0, {floor}], [{wide}, {deep}, {surface}]] }}
[[object]]
name = "plate"
role = "scenery"
collider = true
shape = {{ {plate} }}
"""


def text(plate: str, precision: str, end: float, floor: int, head: int, **sizes: int) -> str:
    """The scene; plate: shape of the floor, with {half}, {under}, {floor} and `sizes`; floor, head,
    sizes (wide, deep and half of the opening at least): in cells."""
    cells = {
        "high": floor + head + 4, "head": head, "floor": floor, "surface": floor + head,
        "under": floor - PLATE, **sizes,
    }  # fmt: skip
    lengths = {name: round(n * DX, 9) for name, n in cells.items()}
    return SCENE.format(precision=precision, end=end, plate=plate.format(**lengths), **lengths)
