"""Motion and filling of a body at the start: velocities, waves of them, volume fractions."""

from typing import Annotated, Literal

from pydantic import model_validator

from vgmpi.runtime.config.schema import Length, Quantity, Share, StrictModel

Velocity = tuple[
    Annotated[float, Quantity("m/s")],
    Annotated[float, Quantity("m/s")],
    Annotated[float, Quantity("m/s")],
]
Wavenumber = Annotated[float, Quantity("rad/m")]
Spin = tuple[
    Annotated[float, Quantity("rad/s")],
    Annotated[float, Quantity("rad/s")],
    Annotated[float, Quantity("rad/s")],
]


class VelocityMode(StrictModel):
    """Wave of velocities at the start: amplitude sin(wave_vector . x + phase_angle)."""

    amplitude: Velocity
    """largest velocity"""
    wave_vector: tuple[Wavenumber, Wavenumber, Wavenumber]
    """wave vector k, 2 pi / wavelength along its direction; x is the position in the domain"""
    phase_angle: Annotated[float, Quantity("rad")] = 0.0
    """"90 deg" makes the sine a cosine"""


class FractionProfile(StrictModel):
    """Volume fraction that changes along one axis, piecewise linear, constant beyond its points."""

    axis: Literal["x", "y", "z"]
    """axis along which it changes"""
    positions: tuple[Length, ...]
    """ascending positions in the domain, two or more"""
    values: tuple[Share, ...]
    """volume fraction at each of them; no particles where it is 0"""

    @model_validator(mode="after")
    def _matches(self) -> "FractionProfile":
        if len(self.positions) < 2 or len(self.positions) != len(self.values):
            raise ValueError("positions and values must be of one length, 2 or more")
        if any(a >= b for a, b in zip(self.positions, self.positions[1:])):
            raise ValueError("positions must ascend")
        return self
