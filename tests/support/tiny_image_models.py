"""Random models with few weights in the shapes of the real ones, saved as those are."""

import json

SIZE = 128  # pixels of the pictures of SAM 1 and 2
PROMPTS = {"hidden_size": 32, "image_size": SIZE, "patch_size": 16, "mask_input_channels": 4}
DECODER = {
    "hidden_size": 32, "mlp_dim": 32, "num_hidden_layers": 1, "num_attention_heads": 2,
    "iou_head_hidden_dim": 16,
}  # fmt: skip
SIZES = {"sam": SIZE, "sam2": SIZE, "sam3": 112}
WORDS = ["cup", "ball", "duck", "box"]


def sam(transformers):
    vision = {
        "hidden_size": 16, "output_channels": 32, "num_hidden_layers": 2, "num_attention_heads": 2,
        "image_size": SIZE, "patch_size": 16, "global_attn_indexes": [1], "window_size": 4,
        "mlp_dim": 32, "num_pos_feats": 16,
    }  # fmt: skip
    return transformers.SamModel(
        transformers.SamConfig(
            vision_config=vision, prompt_encoder_config=PROMPTS, mask_decoder_config=DECODER
        )
    )


def sam2(transformers):
    backbone = {
        "model_type": "sam2_hiera_det_model", "hidden_size": 12, "num_attention_heads": 1,
        "image_size": [SIZE, SIZE], "blocks_per_stage": [1, 2, 2, 2],
        "embed_dim_per_stage": [12, 24, 48, 96], "num_attention_heads_per_stage": [1, 2, 4, 8],
        "window_size_per_stage": [8, 4, 8, 4], "global_attention_blocks": [4],
        "window_positional_embedding_background_size": [7, 7],
    }  # fmt: skip
    vision = {
        "backbone_config": backbone, "backbone_channel_list": [96, 48, 24, 12],
        "backbone_feature_sizes": [[32, 32], [16, 16], [8, 8]], "fpn_hidden_size": 32,
    }  # fmt: skip
    return transformers.Sam2Model(
        transformers.Sam2Config(
            vision_config=vision, prompt_encoder_config=PROMPTS, mask_decoder_config=DECODER
        )
    )


def sam3(transformers):
    backbone = {
        "model_type": "sam3_vit_model", "hidden_size": 32, "intermediate_size": 64,
        "num_hidden_layers": 2, "num_attention_heads": 2, "image_size": 112, "patch_size": 14,
        "window_size": 4, "global_attn_indexes": [1], "pretrain_image_size": 56,
    }  # fmt: skip
    vision = {
        "backbone_config": backbone, "fpn_hidden_size": 32,
        "backbone_feature_sizes": [[32, 32], [16, 16], [8, 8]],
        "scale_factors": [4.0, 2.0, 1.0, 0.5],
    }  # fmt: skip
    prompts = PROMPTS | {"image_size": 112, "patch_size": 14}
    return transformers.Sam3TrackerModel(
        transformers.Sam3TrackerConfig(
            vision_config=vision, prompt_encoder_config=prompts, mask_decoder_config=DECODER
        )
    )


def depth_anything(transformers):
    backbone = transformers.Dinov2Config(
        hidden_size=32, num_hidden_layers=4, num_attention_heads=2, intermediate_size=64,
        image_size=70, patch_size=14, out_features=["stage1", "stage2", "stage3", "stage4"],
        reshape_hidden_states=False, apply_layernorm=True,
    )  # fmt: skip
    return transformers.DepthAnythingForDepthEstimation(
        transformers.DepthAnythingConfig(
            backbone_config=backbone, reassemble_hidden_size=32, patch_size=14,
            neck_hidden_sizes=[8, 16, 16, 16], fusion_hidden_size=16, head_hidden_size=8,
        )
    )  # fmt: skip


def clip(transformers, folder):
    """The model, and in the folder the files of a tokenizer of letters."""
    letters = "abcdefghijklmnopqrstuvwxyz"
    tokens = [*letters, *(f"{c}</w>" for c in letters), "<|startoftext|>", "<|endoftext|>"]
    (folder / "vocab.json").write_text(json.dumps({t: k for k, t in enumerate(tokens)}))
    (folder / "merges.txt").write_text("#version: 0.2\n")
    transformers.CLIPTokenizer(
        str(folder / "vocab.json"), str(folder / "merges.txt")
    ).save_pretrained(folder)
    text = {
        "vocab_size": len(tokens), "hidden_size": 32, "intermediate_size": 64,
        "num_hidden_layers": 2, "num_attention_heads": 2, "max_position_embeddings": 40,
        "bos_token_id": len(tokens) - 2, "eos_token_id": len(tokens) - 1,
        "pad_token_id": len(tokens) - 1, "projection_dim": 16,
    }  # fmt: skip
    vision = {
        "hidden_size": 32, "intermediate_size": 64, "num_hidden_layers": 2,
        "num_attention_heads": 2, "image_size": 64, "patch_size": 16, "projection_dim": 16,
    }  # fmt: skip
    return transformers.CLIPModel(
        transformers.CLIPConfig(text_config=text, vision_config=vision, projection_dim=16)
    )


def saved(kind, folder):
    """The folder of a random model of a kind, the same weights every time."""
    import torch
    import transformers

    torch.manual_seed(0)
    folder.mkdir(parents=True, exist_ok=True)
    makers = {"sam": sam, "sam2": sam2, "sam3": sam3, "depth": depth_anything}
    made = clip(transformers, folder) if kind == "clip" else makers[kind](transformers)
    made.eval().save_pretrained(folder)
    return folder
