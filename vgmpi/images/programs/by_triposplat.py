"""Runs in TripoSplat's own interpreter: one picture with transparency becomes a .ply."""

import argparse


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--image", required=True)
    parser.add_argument("--output", required=True)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--gaussians", type=int, default=60_000)
    given = parser.parse_args()
    from PIL import Image
    from triposplat import TripoSplatPipeline

    pipeline = TripoSplatPipeline()
    made, _ = pipeline.run(Image.open(given.image), seed=given.seed, num_gaussians=given.gaussians)
    made.save_ply(given.output)


if __name__ == "__main__":
    main()
