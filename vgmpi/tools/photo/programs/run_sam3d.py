"""Script for the interpreter of SAM 3D Objects: one picture with alpha becomes a .ply.

It runs in the folder of that repository.
"""

import argparse
import sys


def main() -> None:
    """Read the flags, run the generator and write its Gaussians."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--image", required=True)
    parser.add_argument("--output", required=True)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--config", default="checkpoints/hf/pipeline.yaml")
    args = parser.parse_args()
    import numpy as np
    from PIL import Image

    sys.path.append("notebook")  # the repository keeps its inference module there
    from inference import Inference

    picture = np.asarray(Image.open(args.image).convert("RGBA"))
    result = Inference(args.config, compile=False)(
        picture[..., :3], picture[..., 3] > 127, seed=args.seed
    )
    result["gs"].save_ply(args.output)


if __name__ == "__main__":
    main()
