#!/usr/bin/env bash
# Package:  imageio-ffmpeg 0.8.1 (ffmpeg 9.0.2) and 0.6.0 (ffmpeg 7.0.2), from PyPI, Linux x86-64
# Behavior: -color_primaries and -color_trc behind the input are accepted and ignored by ffmpeg 9.0.2
#           without a word, while -colorspace and -color_range work; ffmpeg 7.0.2 writes all four.
#           The filter setparams sets all four in both.
# Expected: the four tags, or a warning.
# Output seen:
#   ffmpeg 9.0.2 options: yuv420p(tv, smpte170m/unknown/unknown, progressive) rc 0, messages: none
#   ffmpeg 9.0.2 filter:  yuv420p(tv, smpte170m/bt709/iec61966-2-1, progressive) rc 0, messages: none
#   ffmpeg 7.0.2 options: yuv420p(tv, smpte170m/bt709/iec61966-2-1, progressive) rc 0, messages: none
#   ffmpeg 7.0.2 filter:  yuv420p(tv, smpte170m/bt709/iec61966-2-1, progressive) rc 0, messages: none
# Exits nonzero if this changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
for version in 0.8.1 0.6.0; do
  python3 -m venv "$folder/$version"
  "$folder/$version/bin/pip" install -q --disable-pip-version-check "imageio-ffmpeg==$version"
  "$folder/$version/bin/python" - "$folder" <<'PYTHON'
import re, subprocess, sys
import imageio_ffmpeg

program, path = imageio_ffmpeg.get_ffmpeg_exe(), sys.argv[1] + "/v.mp4"
release = imageio_ffmpeg.get_ffmpeg_version().split("-")[0].lstrip("n")
begin = [program, "-y", "-v", "warning", "-f", "lavfi", "-i", "color=c=0x00ff00:s=1280x720:d=1"]
options = ["-colorspace", "smpte170m", "-color_primaries", "bt709"]
options += ["-color_trc", "iec61966-2-1", "-color_range", "tv"]
tags = "setparams=colorspace=smpte170m:color_primaries=bt709:color_trc=iec61966-2-1:range=tv"
ways = {
    "options:": ["-vf", "format=yuv420p", *options],
    "filter: ": ["-vf", "format=yuv420p," + tags],
}
for name, way in ways.items():
    run = subprocess.run([*begin, *way, path], capture_output=True, text=True)
    told = subprocess.run([program, "-i", path], capture_output=True, text=True).stderr
    found = re.search(r"yuv420p\(.*?\)", told)[0]
    print(f"ffmpeg {release} {name} {found} rc {run.returncode}, messages: {run.stderr.strip() or 'none'}")
    ignored = release.startswith("9.") and name == "options:"
    seen = "unknown/unknown" if ignored else "bt709/iec61966-2-1"
    assert run.returncode == 0 and not run.stderr.strip()
    assert found.startswith(f"yuv420p(tv, smpte170m/{seen}"), "the behavior has changed"
PYTHON
done
