"""Runs in the interpreter of SAM 3D Objects, in its repository's folder: one picture with
transparency becomes a .ply."""

import argparse
import sys


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--image", required=True)
    parser.add_argument("--output", required=True)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--config", default="checkpoints/hf/pipeline.yaml")
    given = parser.parse_args()
    import numpy as np
    from PIL import Image

    sys.path.append("notebook")  # where its repository has the door to it
    from inference import Inference

    picture = np.asarray(Image.open(given.image).convert("RGBA"))
    made = Inference(given.config, compile=False)(
        picture[..., :3], picture[..., 3] > 127, seed=given.seed
    )
    made["gs"].save_ply(given.output)


if __name__ == "__main__":
    main()
