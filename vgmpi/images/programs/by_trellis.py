"""Runs in TRELLIS's own interpreter: one picture with transparency becomes a .ply of Gaussians."""

import argparse
import os


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--image", required=True)
    parser.add_argument("--output", required=True)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--weights", default="microsoft/TRELLIS-image-large")
    given = parser.parse_args()
    os.environ.setdefault("SPCONV_ALGO", "native")  # does not try out kernels for a single run
    from PIL import Image
    from trellis.pipelines import TrellisImageTo3DPipeline

    pipeline = TrellisImageTo3DPipeline.from_pretrained(given.weights)
    pipeline.cuda()
    found = pipeline.run(Image.open(given.image), seed=given.seed, formats=["gaussian"])
    found["gaussian"][0].save_ply(given.output)


if __name__ == "__main__":
    main()
