"""Frames of a processed clip as one picture, and the perceptual comparison with the
expected one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from skimage.color import deltaE_ciede2000, rgb2lab
from skimage.metrics import structural_similarity

from arfx.measure.verification import Verified, read_tolerance, verify
from arfx.media.clip import probe
from arfx.media.frames import ClipReader
from arfx.synth.clip import make_clip
from arfx.synth.description import load_scene

SCENES = Path(__file__).parents[2] / "sample_scenes"
FAILED = Path(__file__).parent / "failed"
# Largest colour difference of a region, where a scene's `golden` table states none. Of the
# sample scenes it is up to 2.0 where the source clip is coded otherwise, and 3.0 (0050),
# 4.6 or more where the object throws no shadow.
WIDE = 2.4
PRESETS = sorted((SCENES.parent / "configs").glob("*.toml"))


def verified(
    scene: Path, work: Path, notice: Callable[[str], None] = lambda _: None
) -> Verified:
    """As `arfx verify` does it; of a smaller clip where the `golden` table states a size: a
    large one is for what it costs.
    """
    if size := read_tolerance(scene)["golden"].get("size"):
        whole = load_scene(scene / "scene.toml")
        clip = whole.clip.model_copy(update={"width": size[0], "height": size[1]})
        make_clip(
            whole.model_copy(update={"clip": clip}),
            work / "synth",
            truth_pictures=False,
        )
    return verify(scene, work, lambda *_: None, notice)


def frames_side_by_side(clip: Path, wanted: Sequence[int]) -> np.ndarray:
    """(h, n w, 3) uint8 RGB of the frames with these numbers, upright."""
    with ClipReader(probe(clip)) as reader:
        found = {
            frame.index: frame.rgb8()
            for frame in reader.frames()
            if frame.index in wanted
        }
    return np.hstack([found[n] for n in wanted])


def differences(actual: np.ndarray, expected: np.ndarray) -> dict[str, float]:
    """delta_e_mean, delta_e_p999: CIEDE2000 after a blur of 0.7 px, about what an eye sees
    of a clip; delta_e_wide: the largest one after a blur of a thirtieth of the height, as
    coding changes edges and a faint shadow does not; ssim: of luminance."""
    if actual.shape != expected.shape:
        return {
            "delta_e_mean": np.inf,
            "delta_e_p999": np.inf,
            "delta_e_wide": np.inf,
            "ssim": 0.0,
        }
    (a, b), wide = ([rgb2lab(cv2.GaussianBlur(p.astype(np.float32) / 255, (0, 0), sigma)) for p in (actual, expected)]
                    for sigma in (0.7, len(expected) / 30))  # fmt: skip
    delta = deltaE_ciede2000(a, b)
    ssim = structural_similarity(a[..., 0], b[..., 0], data_range=100.0)
    tail, region = np.percentile(delta, 99.9), deltaE_ciede2000(*wide).max()
    return {
        "delta_e_mean": float(delta.mean()),
        "delta_e_p999": float(tail),
        "delta_e_wide": float(region),
        "ssim": float(ssim),
    }


def broken_bounds(found: dict[str, float], golden: dict[str, Any]) -> list[str]:
    most = {"delta_e_wide": WIDE, **golden}
    names = ("delta_e_mean", "delta_e_p999", "delta_e_wide")
    out = [
        f"{k} is {found[k]:.3f}, at most {most[k]:g}"
        for k in names
        if not found[k] <= most[k]
    ]
    if not found["ssim"] >= golden["ssim_min"]:
        out.append(f"ssim is {found['ssim']:.4f}, at least {golden['ssim_min']:g}")
    return out


def read_rgb(path: Path) -> np.ndarray:
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
    assert picture is not None, f"cannot read {path}"
    return np.ascontiguousarray(picture[..., ::-1])


def write_rgb(path: Path, picture: np.ndarray) -> None:
    assert cv2.imwrite(
        str(path),
        np.ascontiguousarray(picture[..., ::-1]),
        [cv2.IMWRITE_PNG_COMPRESSION, 9],
    )


def write_failure(name: str, actual: np.ndarray, expected: np.ndarray) -> Path:
    """actual.png, expected.png and difference_x10.png in failed/NAME."""
    folder = FAILED / name
    folder.mkdir(parents=True, exist_ok=True)
    write_rgb(folder / "actual.png", actual)
    write_rgb(folder / "expected.png", expected)
    if actual.shape == expected.shape:
        ten = np.clip(128 + 10 * (actual.astype(int) - expected), 0, 255).astype(
            np.uint8
        )
        write_rgb(folder / "difference_x10.png", ten)
    return folder
