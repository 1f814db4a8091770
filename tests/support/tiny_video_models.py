"""Random video models with few weights, saved as the real ones are: by the pipelines of diffusers.
Each has a tokenizer of its own, of letters or of words."""

import json

LETTERS = "abcdefghijklmnopqrstuvwxyz"
WORDS = ["<pad>", "</s>", "<unk>", "a", "soft", "hard", "ball", "bounces", "grey"]


def coder(diffusers, kind="AutoencoderKL"):
    """A coder of single pictures, of half their width."""
    more = {} if kind == "AutoencoderKLTemporalDecoder" else {
        "up_block_types": ("UpDecoderBlock2D",) * 2, "norm_num_groups": 4,
    }  # fmt: skip
    widths = (32, 32) if not more else (8, 16)  # the other one has groups of 32
    return getattr(diffusers, kind)(
        block_out_channels=widths, down_block_types=("DownEncoderBlock2D",) * 2,
        latent_channels=4, **more,
    )  # fmt: skip


def letters(transformers, folder):
    """CLIP's reader of texts, and its tokenizer."""
    folder.mkdir(parents=True, exist_ok=True)
    tokens = [*LETTERS, *(f"{c}</w>" for c in LETTERS), "<|startoftext|>", "<|endoftext|>"]
    (folder / "vocab.json").write_text(json.dumps({t: k for k, t in enumerate(tokens)}))
    (folder / "merges.txt").write_text("#version: 0.2\n")
    words = transformers.CLIPTokenizer(
        str(folder / "vocab.json"), str(folder / "merges.txt"), model_max_length=24
    )
    config = transformers.CLIPTextConfig(
        vocab_size=len(tokens), hidden_size=16, intermediate_size=32, num_hidden_layers=2,
        num_attention_heads=2, max_position_embeddings=24, bos_token_id=len(tokens) - 2,
        eos_token_id=len(tokens) - 1, pad_token_id=len(tokens) - 1,
    )  # fmt: skip
    return words, transformers.CLIPTextModel(config)


def epsilon(diffusers, transformers, folder, guesses="epsilon"):
    words, reads = letters(transformers, folder.parent / "letters")
    unet = diffusers.UNet3DConditionModel(
        block_out_channels=(8, 16), down_block_types=("CrossAttnDownBlock3D", "DownBlock3D"),
        up_block_types=("UpBlock3D", "CrossAttnUpBlock3D"), cross_attention_dim=16,
        attention_head_dim=4, norm_num_groups=4, layers_per_block=1,
    )  # fmt: skip
    return diffusers.TextToVideoSDPipeline(
        vae=coder(diffusers), text_encoder=reads, tokenizer=words, unet=unet,
        scheduler=diffusers.DDIMScheduler(
            prediction_type=guesses, beta_schedule="scaled_linear", beta_start=0.00085,
            beta_end=0.012, clip_sample=False, set_alpha_to_one=False,
        ),
    )  # fmt: skip


def velocity(diffusers, transformers, folder):
    return epsilon(diffusers, transformers, folder, "v_prediction")


def edm(diffusers, transformers, folder):
    unet = diffusers.UNetSpatioTemporalConditionModel(
        in_channels=8, out_channels=4, block_out_channels=(32, 64),
        down_block_types=("CrossAttnDownBlockSpatioTemporal", "DownBlockSpatioTemporal"),
        up_block_types=("UpBlockSpatioTemporal", "CrossAttnUpBlockSpatioTemporal"),
        cross_attention_dim=32, num_attention_heads=(2, 4), layers_per_block=1,
        addition_time_embed_dim=32, projection_class_embeddings_input_dim=96, num_frames=5,
        sample_size=16,
    )  # fmt: skip
    config = transformers.CLIPVisionConfig(
        hidden_size=32, intermediate_size=64, num_hidden_layers=2, num_attention_heads=2,
        image_size=224, patch_size=32, projection_dim=32,
    )  # fmt: skip
    return diffusers.StableVideoDiffusionPipeline(
        vae=coder(diffusers, "AutoencoderKLTemporalDecoder"), unet=unet,
        image_encoder=transformers.CLIPVisionModelWithProjection(config),
        feature_extractor=transformers.CLIPImageProcessorPil(),
        scheduler=diffusers.EulerDiscreteScheduler(
            prediction_type="v_prediction", timestep_type="continuous", use_karras_sigmas=True,
            sigma_min=0.002, sigma_max=700.0, timestep_spacing="leading", steps_offset=1,
        ),
    )  # fmt: skip


def flow(diffusers, transformers, folder):
    import tokenizers
    from tokenizers import models, pre_tokenizers, processors

    made = tokenizers.Tokenizer(models.WordLevel({w: k for k, w in enumerate(WORDS)}, "<unk>"))
    made.pre_tokenizer = pre_tokenizers.Whitespace()
    made.post_processor = processors.TemplateProcessing(
        single="$A </s>", special_tokens=[("</s>", WORDS.index("</s>"))]
    )
    words = transformers.PreTrainedTokenizerFast(
        tokenizer_object=made, pad_token="<pad>", eos_token="</s>", unk_token="<unk>"
    )
    reads = transformers.UMT5Config(
        vocab_size=len(WORDS), d_model=16, d_kv=8, d_ff=32, num_layers=2, num_heads=2
    )
    return diffusers.WanPipeline(
        tokenizer=words, text_encoder=transformers.UMT5EncoderModel(reads),
        vae=diffusers.AutoencoderKLWan(
            base_dim=8, z_dim=4, dim_mult=[1, 1, 1, 1], num_res_blocks=1,
            temperal_downsample=[False, True, True], latents_mean=[0.1, -0.1, 0.0, 0.2],
            latents_std=[0.5, 0.6, 0.7, 0.8],
        ),
        transformer=diffusers.WanTransformer3DModel(
            num_attention_heads=2, attention_head_dim=12, in_channels=4, out_channels=4,
            text_dim=16, freq_dim=16, ffn_dim=16, num_layers=2, rope_max_seq_len=32,
        ),
        scheduler=diffusers.FlowMatchEulerDiscreteScheduler(shift=3.0),
    )  # fmt: skip


MAKERS = {"epsilon": epsilon, "velocity": velocity, "edm": edm, "flow": flow}


def saved(name, folder):
    """The folder of a random model, the same weights every time. What a fresh model's last layers
    leave out, so that it heeds neither text nor picture, is filled in."""
    import diffusers
    import torch
    import transformers

    torch.manual_seed(0)
    pipeline = MAKERS[name](diffusers, transformers, folder)
    model = getattr(pipeline, "unet", None) or pipeline.transformer
    with torch.no_grad():
        for weight in model.parameters():
            if not weight.any():
                weight.normal_(0, 0.2)
    pipeline.save_pretrained(folder, safe_serialization=True)
    return folder
