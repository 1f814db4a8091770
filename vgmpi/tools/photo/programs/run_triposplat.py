"""Script for the interpreter of TripoSplat: one picture with alpha becomes a .ply."""

import argparse


def main() -> None:
    """Read the flags, run the generator and write its Gaussians."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--image", required=True)
    parser.add_argument("--output", required=True)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--gaussians", type=int, default=60_000)
    args = parser.parse_args()
    from PIL import Image
    from triposplat import TripoSplatPipeline

    pipeline = TripoSplatPipeline()
    result, _ = pipeline.run(Image.open(args.image), seed=args.seed, num_gaussians=args.gaussians)
    result.save_ply(args.output)


if __name__ == "__main__":
    main()
