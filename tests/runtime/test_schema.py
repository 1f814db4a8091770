"""Quantities with units, and what a user reads when one is wrong."""

import math
from typing import Annotated

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from vgmpi.runtime.config.schema import (
    Point,
    Quantity,
    StrictModel,
    compatible_units,
    format_validation_errors,
    unit,
)
from vgmpi.runtime.message_text import did_you_mean


@pytest.mark.parametrize(
    "text, si, value",
    [
        ("2 cm", "m", 0.02),
        ("35 cm", "m", 0.35),  # 35 * 0.01 is the float after it
        ("-1.5e1 mm", "m", -0.015),
        ("0.1 MPa", "Pa", 1e5),
        ("1 g/cm3", "kg/m3", 1000.0),
        ("2.5 t/m3", "kg/m3", 2500.0),
        ("3.6 km/h", "m/s", 1.0),
        ("180 deg", "rad", math.pi),
        ("60 rpm", "rad/s", 2 * math.pi),
        ("1 mPa s", "Pa s", 1e-3),
        ("1 kg/m/s", "Pa s", 1.0),
        ("10 min", "s", 600.0),
        ("0.2 %", "", 0.002),
        ("0.3", "", 0.3),
        ("1 N/m2", "Pa", 1.0),
        ("2 m^2/s", "m2/s", 2.0),
        (" 4.cm ", "m", 0.04),
        (3, "m", 3.0),
        (0.25, "Pa", 0.25),
    ],
)
def test_texts_and_numbers_become_si(text, si, value):
    assert Quantity(si).parse(text) == value


@pytest.mark.parametrize(
    "value, si, says",
    [
        ("2", "m", "the text has no unit"),
        ("2 kg", "m", "'kg' does not measure a length; expected a number [m]"),
        ("2 Pa", "kg/m3", "'Pa' does not measure a density; expected a number [kg/m3] or a text"),
        ("2 furlong", "m", "'furlong' is not a unit known here"),
        ("cm", "m", "expected a number [m] or a text such as '2 m'"),
        ("", "m", "expected a number [m]"),
        (True, "m", "expected a number [m]"),
        (None, "", "expected a number"),
        ([1.0], "s", "units: s, ms, us, min, h"),
        (math.nan, "m", "must be finite"),
        (math.inf, "m", "must be finite"),
        ("1e999999999 m", "m", "must be finite"),
        ("1 cm; 2 cm", "m", "not a unit"),
    ],
)
def test_refused_with_what_is_allowed(value, si, says):
    with pytest.raises(ValueError, match=".") as caught:
        Quantity(si).parse(value)
    assert says in str(caught.value)


def test_bounds_name_the_unit_and_hold_in_si():
    density = Quantity("kg/m3", gt=0, le=2e4)
    assert density.parse("20 t/m3") == 2e4
    for bad in ("-1 g/cm3", 0, "20.001 t/m3", math.nan):
        with pytest.raises(ValueError, match="must be > 0 kg/m3 and <= 20000 kg/m3"):
            density.parse(bad)


@given(st.floats(-1e6, 1e6), st.sampled_from(["m", "km", "cm", "mm", "um"]))
def test_a_unit_scales_and_nothing_else(number, name):
    expected = number * float(unit(name)[0])
    assert Quantity("m").parse(f"{number!r} {name}") == pytest.approx(expected, rel=1e-15)


def test_sizes_beyond_all_measure():
    """Nothing is divided by what has no sign: it may come as close to 0 as it likes."""
    for kind in (Quantity("m", gt=0), Quantity("m", ge=0)):
        for bad in (5e-324, "1e-99 mm", 1e101, 10**200):
            with pytest.raises(ValueError, match=r"from 1e-100 to 1e\+100 in size"):
                kind.parse(bad)
    assert Quantity("m", ge=0).parse(0) == 0 and Quantity("m").parse(-1e-200) == -1e-200
    with pytest.raises(ValueError, match="must be 0 or from 1e-100"):
        Quantity("m").parse(-1e101)


def test_documented_units_measure_the_same():
    for si in ("m", "s", "Pa", "kg/m3", "m/s", "m/s2", "Pa s", "rad", "rad/s", "m2/s", "W"):
        names = compatible_units(si)
        assert si in names
        assert all(unit(name)[1] == unit(si)[1] for name in names)


class Inner(StrictModel):
    radius: Annotated[float, Quantity("m", gt=0)]


class Outer(StrictModel):
    size: Point = (0.0, 0.0, 0.0)
    inner: Inner | None = None
    direct: Quantity("s") = 1.0  # the short spelling


def complaints(**data):
    try:
        Outer.model_validate(data)
    except ValidationError as error:
        return format_validation_errors(error, Outer)
    return []


def test_explained_errors_have_path_hint_and_value():
    found = dict(complaints(sise=1, size=[1, "2 cm"], inner={"radus": 3}, direct="1 m"))
    assert "did you mean 'size'?" in found[("sise",)]
    assert "too few values" in found[("size",)]
    assert "did you mean 'radius'?" in found[("inner", "radus")]
    assert "known here" not in found[("inner", "radus")]  # which would hide the hint
    assert "required key is missing" in found[("inner", "radius")]
    assert "'m' does not measure a time" in found[("direct",)]
    assert "got '1 m'" in found[("direct",)]
    assert len(found) == 5


def test_a_table_cannot_change():
    table = Outer(size=["1 cm", 2, 3])
    assert table.size == (0.01, 2.0, 3.0)
    with pytest.raises(ValidationError):
        table.direct = 2.0


def test_nearest_says_nothing_when_nothing_is_near():
    assert did_you_mean("frams", ["frames", "end"]) == " (did you mean 'frames'?)"
    assert did_you_mean("zzz", ["frames", "end"]) == ""
