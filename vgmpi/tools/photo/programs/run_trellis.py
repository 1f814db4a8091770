"""Script for the interpreter of TRELLIS: one picture with alpha becomes a .ply of Gaussians."""

import argparse
import os


def main() -> None:
    """Read the flags, run the generator and write its Gaussians."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--image", required=True)
    parser.add_argument("--output", required=True)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--weights", default="microsoft/TRELLIS-image-large")
    args = parser.parse_args()
    os.environ.setdefault(
        "SPCONV_ALGO", "native"
    )  # skips the benchmark of kernels, which a single run does not repay
    from PIL import Image
    from trellis.pipelines import TrellisImageTo3DPipeline

    pipeline = TrellisImageTo3DPipeline.from_pretrained(args.weights)
    pipeline.cuda()
    result = pipeline.run(Image.open(args.image), seed=args.seed, formats=["gaussian"])
    result["gaussian"][0].save_ply(args.output)


if __name__ == "__main__":
    main()
