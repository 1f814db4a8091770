"""Schema of the table [sds] of a fit file: a video model that rates the runs."""

from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from vgmpi.runtime.config.schema import StrictModel


def _not_blank(value: str) -> str:
    """Require a text that is not blank."""
    if not value.strip():
        raise ValueError("must say something")
    return value


def _increasing(value: tuple[float, float]) -> tuple[float, float]:
    """Require [low, high]."""
    if not value[0] <= value[1]:
        raise ValueError("must be [least, most]")
    return value


Text = Annotated[str, AfterValidator(_not_blank)]
Noise = Annotated[float, Field(gt=0, lt=1, strict=True)]
Pixels = Annotated[int, Field(ge=16, le=8192, strict=True)]


class Sds(StrictModel):
    """A video model that rates how likely the pictures of a run are."""

    model: Text
    """folder with a model in the layout of diffusers, relative to fit.toml; nothing is fetched"""
    render: Text
    """the render.toml by which runs are drawn; of one camera"""
    prompt: Text | None = None
    """text that describes the video, for a model conditioned on a text"""
    negative_prompt: str = ""
    """text of the unconditional half of the guidance, for such a model"""
    image: Text | None = None
    """path of the first picture, for a model conditioned on an image"""
    guidance_scale: Annotated[float, Field(ge=0, le=1000, strict=True)] | None = None
    """extrapolation from the prediction without to the one with the prompt;
    default: that of the model's kind"""
    noise_samples: Annotated[int, Field(ge=1, le=1000, strict=True)] = 8
    """number of noise samples, the same for all runs"""
    noise_levels: Annotated[tuple[Noise, Noise], AfterValidator(_increasing)] = (0.2, 0.8)
    """lowest and highest noise level in [0, 1] over which the samples are spread"""
    seed: Annotated[int, Field(ge=0, le=2**31, strict=True)] = 1
    """random seed of the noise"""
    precision: Literal["float32", "bfloat16", "float16"] = "float32"
    """precision of the model's weights; pictures are encoded in float32"""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """device of the model; auto: a GPU if there is one"""
    size: tuple[Pixels, Pixels] | None = None
    """width and height [pixels] of the model's input; default: those of render.toml"""
    frames: Annotated[int, Field(ge=1, le=1000, strict=True)] | None = None
    """number of input frames, spread over those drawn; default: all of them"""
    fps: Annotated[float, Field(gt=0, le=1000, strict=True)] = 7.0
    """frames per second given to a model conditioned on an image"""
    motion_bucket_id: Annotated[int, Field(ge=0, le=1000, strict=True)] = 127
    """amount of motion given to such a model"""

    @model_validator(mode="after")
    def _one_condition(self):
        """Require exactly one condition, and only options that go with it."""
        if (self.prompt is None) == (self.image is None):
            message = "both given" if self.prompt is not None else "nothing that the model goes by"
            raise ValueError(f"{message}: give exactly one of prompt, image")
        unsuitable = (
            ("fps", "motion_bucket_id") if self.prompt is not None else ("negative_prompt",)
        )
        unused = [name for name in unsuitable if name in self.model_fields_set]
        if unused:
            condition = "a prompt" if self.prompt is not None else "an image"
            raise ValueError(f"with {condition} there is no {', '.join(unused)}")
        if self.prompt is not None and self.prompt.split() == self.negative_prompt.split():
            raise ValueError("negative_prompt is the prompt: there is nothing to guide by")
        return self
