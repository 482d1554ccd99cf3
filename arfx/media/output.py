"""Everything about the output file that is decided before rendering: codec, container,
pixel format, tags.
"""

import itertools
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import av

from arfx.core.codec import Document
from arfx.errors import ConfigError, InputError
from arfx.media import hdr
from arfx.media.clip import PHOTO, UNSPECIFIED, ClipInfo, ffmpeg_command
from arfx.media.codecs import (
    ALIASES,
    CODECS,
    CONTAINER_SUFFIX,
    SUFFIX_CONTAINER,
    Codec,
    nearest_format,
    open_encoder,
    supported_codecs,
)
from arfx.media.photos import WRITTEN
from arfx.media.planes import PixelLayout

MAX_TICKS = (1 << 31) - 1  # of a frame's time in mp4 and mov
_PATTERN = re.compile(
    r"((?:[^%]|%%)*)%0?\d{0,2}d((?:[^%]|%%)*)"
)  # one number of at most 99 digits


@dataclass(frozen=True)
class OutputSettings:
    """What the user asked for; None = from the file's extension and the clip."""

    codec: str | None = None
    crf: float | None = None
    preset: str | None = None
    pixel_format: str | None = None


@dataclass(frozen=True)
class OutputPlan(Document):
    """What will be written. container : FFmpeg's muxer, "" for an image sequence, PHOTO for
    one picture
    options : the encoder's, in order
    matrix, full_range : of the written samples;  *_tag : as written into the file (ITU-T H.273)
    streams : indices of the source's further streams that are copied"""

    path: Path
    codec: str
    container: str
    pixel_format: str
    options: hdr.Options
    matrix: str
    full_range: bool
    matrix_tag: int = UNSPECIFIED
    range_tag: int = 0
    transfer_tag: int = UNSPECIFIED
    primaries_tag: int = UNSPECIFIED
    streams: tuple[int, ...] = ()
    notices: tuple[str, ...] = ()

    @property
    def is_sequence(self) -> bool:
        """Whether it is a folder of images."""
        return self.container == ""


def plan_output(
    info: ClipInfo, path: Path, settings: OutputSettings | None = None
) -> OutputPlan:
    """Decides how a clip is written to `path`.
    Raises ConfigError: unknown extension, codec or pixel format; a container that cannot
    hold the codec, or the clip's audio (the message names the ones that can); a picture
    size that the codec has no pixel format for.
    InputError: an interlaced clip, for a codec without fields."""
    path, settings = Path(path), settings or OutputSettings()
    container, codec = choose_format(path, settings, info.hdr)
    if codec.sequence:
        return _plan_sequence(info, path, codec, settings)
    if container == PHOTO:
        if info.container != PHOTO:
            hint = "out.mp4, or images with a number in its name, for example frames/%06d.png"
            raise ConfigError(f"{path} is one picture, {info.path} is a clip", hint)
        target = _pixel_format(info, codec, settings, [])
        options = _options(codec, OutputSettings())
        return OutputPlan(
            path, codec.name, PHOTO, target.name, options, info.matrix, True
        )
    if container not in codec.containers:
        hint = "one of " + ", ".join(CONTAINER_SUFFIX[c] for c in codec.containers)
        raise ConfigError(
            f"{path}: a {path.suffix} file cannot hold {codec.name}", hint
        )
    if info.fields and not codec.fields:
        hint = (
            "--codec h264 in another file than .webm, or first:"
            f" {ffmpeg_command(info.path, 'bwdif', 'progressive')}"
        )
        raise InputError(
            f"{info.path} is interlaced, which {codec.name} files cannot say", hint
        )
    notices: list[str] = []
    streams = _further_streams(info, container, codec, path, notices)
    target = _pixel_format(info, codec, settings, notices)
    from_rgb, to_rgb = info.layout.kind == "rgb", target.kind == "rgb"
    full = to_rgb or (info.full_range and not from_rgb and codec.full_range)
    matrix, matrix_tag, range_tag = info.matrix, info.matrix_tag, info.range_tag
    if from_rgb and not to_rgb:
        matrix, matrix_tag, range_tag = "bt709", 1, 1
        notices.append("the RGB source is converted to YUV (bt709, limited range)")
    elif info.full_range != full:
        range_tag = 1
        if not full:
            limited = "files are limited range: the full-range source is converted"
            notices.append(f"{codec.name} {limited}")
    elif full and target.kind == "yuv":
        range_tag = 2
    if codec.name == "prores" and matrix_tag == UNSPECIFIED:
        # its bitstream always names one: then the one that was used
        matrix_tag = {"bt709": 1, "bt601": 6}[matrix]
    if counts := {"matroska": "Matroska", "webm": "WebM"}.get(container):
        notices.append(
            f"{counts} counts time in milliseconds: frame times are rounded to 1 ms"
        )
    static = (info.mastering_display, info.content_light)
    options = hdr.with_static_data(
        _options(codec, settings), codec.name, *static, notices
    )
    return OutputPlan(
        path,
        codec.name,
        container,
        target.name,
        options,
        matrix,
        full,
        matrix_tag,
        range_tag,
        info.transfer_tag,
        info.primaries_tag,
        streams,
        tuple(notices),
    )


def choose_format(
    path: Path, settings: OutputSettings, hdr: bool = False
) -> tuple[str, Codec]:
    """Container, as of OutputPlan, and codec. Raises ConfigError for an extension or a codec
    that does not exist, or images without a number in their names.

    hdr : the clip is HLG or PQ, which players expect in H.265"""
    suffix, name = path.suffix.lower(), (settings.codec or "").lower()
    name = ALIASES.get(name, name)
    if name and name not in CODECS:
        raise ConfigError(
            f"unknown codec {settings.codec!r}", "one of " + ", ".join(CODECS)
        )
    if suffix in WRITTEN and not names_sequence(path):
        for given in ("codec", "crf", "preset"):
            if getattr(settings, given) is not None:
                raise ConfigError(
                    f"{path}: one picture has no setting {given!r}", "leave it out"
                )
        return PHOTO, CODECS["ffv1"]
    if names_sequence(path) or (name and CODECS[name].sequence):
        kind = name or suffix[1:]
        if kind in CODECS and not CODECS[kind].sequence:
            raise ConfigError(
                f"{path}: codec {kind} makes no images",
                f"--codec {suffix[1:]}, or a video: out.mkv",
            )
        if suffix != f".{kind}":
            raise ConfigError(
                f"{path}: codec {kind} writes images named *.{kind}",
                f"for example frames/%06d.{kind}",
            )
        if not _PATTERN.fullmatch(path.name):
            raise ConfigError(
                f"{path}: an image sequence needs one number in its name",
                f"for example frames/%06d{suffix}",
            )
        return "", CODECS[kind]
    if (container := SUFFIX_CONTAINER.get(suffix)) is None:
        raise ConfigError(
            f"{path}: unknown output format {suffix or '(no extension)'!r}",
            "one of .mp4, .mkv, .mov, .webm, or images as frames/%06d.png or"
            " frames/%06d.exr",
        )
    usual = "av1" if container == "webm" else "h265" if hdr else "h264"
    return container, CODECS[name or usual]


def names_sequence(path: Path) -> bool:
    """Whether an output name stands for a folder of images."""
    return re.search(r"(?i).\.exr$|%.*\.png$", path.name) is not None


def image_names(pattern: str) -> Callable[[str], bool]:
    """Whether a file name is one that the pattern makes of some frame number.

    a.png is A.PNG: many disks tell no cases apart.
    """
    around = _PATTERN.fullmatch(pattern)
    assert around is not None
    head, tail = (re.escape(text.replace("%%", "%")) for text in around.groups())
    number = re.compile(rf"{head} *(\d{{1,99}}){tail}", re.IGNORECASE)

    def named(name: str) -> bool:
        found = number.fullmatch(name)
        return found is not None and (pattern % int(found[1])).lower() == name.lower()

    return named


def _options(codec: Codec, settings: OutputSettings) -> hdr.Options:
    options, crf, preset = dict(codec.options), settings.crf, settings.preset
    for what in ("crf", "preset"):
        asked, usual = getattr(settings, what), getattr(codec, what)
        if usual is not None:
            value = usual if asked is None else asked
            options[what] = value if what == "preset" else f"{value:g}"
        elif asked is not None:
            raise ConfigError(
                f"codec {codec.name} has no setting {what!r}", "leave it out"
            )
    if crf is not None and not 0 <= crf <= 63:
        raise ConfigError(
            f"crf must be within 0 and 63, is {crf:g}",
            "18 is nearly transparent, 28 is small",
        )
    if preset is not None:  # the encoder alone knows its presets
        ctx: Any = av.CodecContext.create(codec.encoder, "w")
        ctx.width = ctx.height = 64
        ctx.pix_fmt, ctx.time_base = codec.formats[0].name, Fraction(1, 25)
        ctx.options = dict(options)
        try:
            open_encoder(ctx)
        except (av.error.FFmpegError, ValueError):
            usual = (
                f"{codec.preset} is the usual one; `ffmpeg -h encoder={codec.encoder}`"
                " lists them"
            )
            raise ConfigError(
                f"{codec.encoder} does not take preset {preset!r}", usual
            ) from None
    return tuple(sorted(options.items()))


def check_times(plan: OutputPlan, pts: Sequence[int], time_base: Fraction) -> None:
    """Raises ConfigError where a frame is shown for longer than the output's container can hold."""
    longest = max((b - a for a, b in itertools.pairwise(pts)), default=0)
    if plan.container in ("mp4", "mov") and longest > MAX_TICKS:
        days = float(longest * time_base) / 86400
        message = (
            f"{plan.path}: a frame of the clip is shown for {days:.3g} days, longer than"
            f" {plan.path.suffix} files can say"
        )
        raise ConfigError(
            message, "-o out.mkv, or only a part with --start and --end"
        )


def _pixel_format(
    info: ClipInfo, codec: Codec, settings: OutputSettings, notices: list[str]
) -> PixelLayout:
    source = info.layout
    odd = info.coded_width % 2, info.coded_height % 2
    size = f"{info.coded_width}x{info.coded_height}"
    if asked := settings.pixel_format:
        plain = asked.replace("yuvj", "yuv")
        held = next((f for f in codec.formats if f.name == plain), None)
        if held is None:
            raise ConfigError(
                f"codec {codec.name} cannot write pixel format {asked!r}",
                "one of " + ", ".join(f.name for f in codec.formats),
            )
        if not (codec.lossless or held.holds(odd)):
            raise ConfigError(
                f"pixel format {asked} needs even sizes, the clip is {size}",
                "use yuv444p",
            )
        return held
    if source.alpha:
        notices.append("the clip's transparency is not written")
    target = nearest_format(source, codec, odd)
    if target is None:
        able = (
            c.name
            for c in CODECS.values()
            if c.containers and nearest_format(source, c, odd)
        )
        raise ConfigError(
            f"codec {codec.name} cannot write the odd picture size {size}",
            f"one of {', '.join(able)}",
        )
    both_yuv = target.kind == source.kind == "yuv"
    if both_yuv and target.subsampling != source.subsampling:
        too_odd = any(odd) and target.subsampling == "444"
        why = f"{codec.name} has no {source.subsampling}"
        why = "the picture size is odd" if too_odd else why
        written = ":".join(target.subsampling)
        notices.append(f"chroma is written as {written}: {why}")
    if target.depth < source.depth:
        notices.append(
            f"{source.depth}-bit samples are written with {target.depth} bits: {codec.name}"
            " has no more"
        )
    return target


def _further_streams(
    info: ClipInfo, container: str, codec: Codec, path: Path, notices: list[str]
) -> tuple[int, ...]:
    kept, held = [], supported_codecs(container)
    for s in info.streams:
        copied = s.kind in ("audio", "video", "subtitle") and not s.picture
        if s.used:
            continue
        if s.broken:
            notices.append(
                f"stream {s} is left out: it is damaged, its sample rate is not known"
            )
        elif copied and s.codec in held:
            kept.append(s.index)
        elif s.kind == "audio":
            sound = {a.codec for a in info.audio if not a.broken}
            able = " or ".join(
                CONTAINER_SUFFIX[c]
                for c in codec.containers
                if sound <= supported_codecs(c)
            )
            other = f"no container of {codec.name} can; use another codec, or .mkv"
            raise ConfigError(
                f"{path}: a {path.suffix} file cannot hold the clip's audio ({s.codec})",
                f"use {able}" if able else other,
            )
        else:
            why = (
                "a cover picture"
                if s.picture
                else f"{path.suffix} files cannot hold it"
            )
            notices.append(f"stream {s} is left out: {why}")
    return tuple(kept)


def _plan_sequence(
    info: ClipInfo, path: Path, codec: Codec, settings: OutputSettings
) -> OutputPlan:
    if settings != OutputSettings(settings.codec):
        raise ConfigError(
            f"{codec.name} images take no crf, preset or pixel format",
            "leave them out",
        )
    fmt = "rgb48be" if info.bit_depth > 8 else "rgb24"
    fmt = "gbrpf32le" if codec.name == "exr" else fmt
    notices = ["frame times are written to times.txt beside the images"]
    others = [str(s) for s in info.streams if not s.used]
    if others:
        notices.append(
            f"images hold no further streams; left out: {', '.join(others)}"
        )
    return OutputPlan(
        path, codec.name, "", fmt, (), info.matrix, True, notices=tuple(notices)
    )
