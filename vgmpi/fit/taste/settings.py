"""[sds] of a fit file: the video model whose taste runs are held to."""

from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from ...tables import Table


def _some(value: str) -> str:
    if not value.strip():
        raise ValueError("must say something")
    return value


def _rising(value: tuple[float, float]) -> tuple[float, float]:
    if not value[0] <= value[1]:
        raise ValueError("must be [least, most]")
    return value


Text = Annotated[str, AfterValidator(_some)]
Noise = Annotated[float, Field(gt=0, lt=1, strict=True)]
Pixels = Annotated[int, Field(ge=16, le=8192, strict=True)]


class Sds(Table):
    """A video model that says how likely a run's pictures are to it."""

    model: Text
    """folder with a model in the layout of diffusers, relative to fit.toml; nothing is fetched"""
    render: Text
    """the render.toml by which runs are drawn; of one camera"""
    prompt: Text | None = None
    """of a model that goes by a text: what is to be seen"""
    negative_prompt: str = ""
    """of the same: the text of the other half of the guidance"""
    image: Text | None = None
    """of a model that goes by a picture: the first one"""
    guidance: Annotated[float, Field(ge=0, le=1000, strict=True)] | None = None
    """how far the guess goes from the half without to the half with the prompt, and beyond;
    default: the model's kind's"""
    draws: Annotated[int, Field(ge=1, le=1000, strict=True)] = 8
    """of noise, the same for all runs"""
    times: Annotated[tuple[Noise, Noise], AfterValidator(_rising)] = (0.2, 0.8)
    """least and largest level of noise, of 0 .. 1, over which they are spread"""
    seed: Annotated[int, Field(ge=0, le=2**31, strict=True)] = 1
    """of the draws"""
    precision: Literal["float32", "bfloat16", "float16"] = "float32"
    """of the model's weights; pictures are coded in float32"""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """where it is asked; auto: a card if there is one"""
    size: tuple[Pixels, Pixels] | None = None
    """width and height [pixels] that the model sees; default: those of render.toml"""
    frames: Annotated[int, Field(ge=1, le=1000, strict=True)] | None = None
    """how many frames it sees, spread over those drawn; default: all of them"""
    fps: Annotated[float, Field(gt=0, le=1000, strict=True)] = 7.0
    """of a model that goes by a picture: frames per second that it is told"""
    motion: Annotated[int, Field(ge=0, le=1000, strict=True)] = 127
    """of the same: how much it is told that things move (motion_bucket_id)"""

    @model_validator(mode="after")
    def _one_wish(self):
        if (self.prompt is None) == (self.image is None):
            said = "both given" if self.prompt is not None else "nothing that the model goes by"
            raise ValueError(f"{said}: give exactly one of prompt, image")
        other = ("fps", "motion") if self.prompt is not None else ("negative_prompt",)
        wrong = [name for name in other if name in self.model_fields_set]
        if wrong:
            given = "a prompt" if self.prompt is not None else "an image"
            raise ValueError(f"with {given} there is no {', '.join(wrong)}")
        if self.prompt is not None and self.prompt.split() == self.negative_prompt.split():
            raise ValueError("negative_prompt is the prompt: there is nothing to guide by")
        return self
