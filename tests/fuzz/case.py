"""What an attack is: files laid in a folder of its own, a command line run there, and what
may come of it.
"""

from __future__ import annotations

import json
import random
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

REFUSED = frozenset(
    {0, 2, 3, 4}
)  # how a command may end; 5 is kept for true faults of the disk

# What a number, a word or a list in any input may be replaced by, as TOML, YAML and JSON write it.
NUMBERS = (
    "nan", "inf", "-inf", "0", "-0.0", "-1", "1", "2", "255", "256", "65536", "1e-320", "1e-300", "1e-12", "1e-6", "0.5", "1e6",
    "1e9", "1e38", "1e39", "1e155", "1e308", "-1e308", "1e400", "2147483647", "2147483648", "4294967296", "-2147483649",
    "9223372036854775807", "9223372036854775808", "18446744073709551616", "9" * 400, "9" * 5000, "0x7fffffff", "1_000",
)  # fmt: skip
WORDS = (
    "", " ", "a", "0", "true", "null", "None", "nan", "~", "..", "/", "%s%n%d", "{0}", "\u202eabc", "😀", "é" * 300, "a" * 70000,
    "-", "--help", "\x07\x1b[31m", "x\ny", "\ufeff", "http://127.0.0.1:9/a", "file:///etc/hostname", "/dev/zero", "/etc/hostname",
    "../outside/secret.bin", "../outside/secret.png", "~/a", "$HOME", "con", "12:30", "pipe:0", "tcp://127.0.0.1:9", "concat:a|b",
)  # fmt: skip


@dataclass
class Case:
    """folder : current folder of the command, all that it may read and write;  args : of `arfx`

    output : what it writes if it ends with 0, None = nothing that is looked at;  codes :
    how it may end
    start : run in the child before the command;  cold : a process of its own, imports and
    all, instead of a warm fork
    stop : (signal, "time" or "event", seconds or number): when the command is stopped;
    between : what is done then
    after : the command that is run then, first stopped by `stop_again`;  beside : a command
    that runs at the same time
    expect : digest of the output, where it is known;  keeps : the job folder may stay;
    leaves : what else may stay
    lost : the output cannot be seen from outside;  silent : nobody can hear messages;  note
    : what was done, for people
    """

    folder: Path
    args: list[str]
    output: str | None = "out.mp4"
    codes: frozenset[int] = REFUSED
    start: Callable[[], None] | None = None
    cold: bool = False
    stop: tuple[int, str, float] | None = None
    stop_again: tuple[int, str, float] | None = None
    between: Callable[[], None] | None = None
    after: list[str] | None = None
    beside: list[str] | None = None
    expect: str | None = None
    keeps: bool = False
    leaves: tuple[str, ...] = ()
    lost: bool = False
    silent: bool = False
    note: str = ""
    kind: str = ""
    count: Path | None = None  # where the number of events is written


Build = Callable[
    [random.Random, Path, Path], Case
]  # (random numbers, the case's folder, the material) -> Case


def process(folder: Path, material: Path, **changed: str | None) -> list[str]:
    """The usual job of the small clip, whose inputs are copied into `folder` where
    `changed` does not name others.

    changed : option -> value, None = left out;  clip, camera, model, o and so on, with _ for -
    """
    options: dict[str, str | None] = {
        "clip": "clip.mp4", "camera": "camera.yaml", "model": "model.glb", "marker": "36h11:3:100mm", "fit": "8cm",
        "o": "out.mp4",
    }  # fmt: skip
    files = [(name, str(options[name])) for name in ("clip", "camera", "model")]
    options |= changed
    for name, usual in files:
        if options[name] == usual and not (folder / usual).exists():
            shutil.copy(material / usual, folder / usual)
    clip = options.pop("clip")
    named = [
        (("-" if len(k) == 1 else "--") + k.replace("_", "-"), v)
        for k, v in options.items()
        if v is not None
    ]
    # an argument that begins with - is an option to every program: `--` is the way to say
    # that it is not
    late = ["--", clip] if clip is not None and clip.startswith("-") else []
    early = [] if clip is None or late else [clip]
    return [
        "process",
        *early,
        *(word for pair in named for word in pair),
        "--json",
        *late,
    ]


def mutated_bytes(rng: random.Random, data: bytes) -> bytes:
    """A few of: bits turned, a number put in, a stretch cleared, repeated, moved or cut
    out, the end cut off.
    """
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 4, 16))):
        if len(out) < 8:
            break
        # headers are small and matter most: half of the places lie in them
        at = rng.randrange(min(len(out), rng.choice((64, 1024, len(out)))))
        size = rng.choice((1, 2, 4, 8, 64, 512))
        what = rng.randrange(7)
        if what == 0:
            out[at] ^= 1 << rng.randrange(8)
        elif what == 1:
            width = rng.choice((1, 2, 4, 8))
            value = rng.choice(
                (
                    0,
                    1,
                    (1 << 8 * width) - 1,
                    (1 << 8 * width - 1) - 1,
                    1 << 8 * width - 1,
                )
            )
            out[at : at + width] = value.to_bytes(
                width, rng.choice(("big", "little"))
            )
        elif what == 2:
            out[at : at + size] = bytes(size)
        elif what == 3:
            out[at:at] = out[at : at + size]
        elif what == 4:
            del out[at : at + size]
        elif what == 5:
            out[at : at + size] = rng.randbytes(size)
        else:
            del out[at:]
    return bytes(out)


def mutated_text(rng: random.Random, text: str) -> str:
    """A few of: a number or a word replaced, a line repeated, dropped or moved, a stretch
    nested deeply.
    """
    for _ in range(rng.choice((1, 1, 2, 5))):
        what = rng.randrange(8)
        tokens = list(re.finditer(r"-?\d[\d.]*(?:[eE][+-]?\d+)?|[A-Za-z_]{2,}", text))
        lines = text.splitlines(keepends=True) or [""]
        line = rng.randrange(len(lines))
        if what < 5 and tokens:
            token = rng.choice(tokens)
            number = token[0][0] in "-0123456789"
            new = rng.choice(NUMBERS if number == (rng.random() < 0.8) else WORDS)
            text = text[: token.start()] + new + text[token.end() :]
        elif what == 5:
            lines[line:line] = lines[line : line + 1] * rng.choice((1, 3, 2000))
            text = "".join(lines)
        elif what == 6:
            del lines[line]
            text = "".join(lines)
        else:
            at, deep = rng.randrange(len(text) + 1), rng.choice((3, 200, 20000))
            text = (
                text[:at]
                + rng.choice(("[", "{", "(", "a: ", "- ", "a.", '"')) * deep
                + text[at:]
            )
    return text


def mutated_tree(rng: random.Random, tree: Any) -> Any:
    """A JSON document in which a few values are others, gone, doubled, or hold themselves
    many times over.
    """
    tree = json.loads(json.dumps(tree))
    for _ in range(rng.choice((1, 1, 2, 4))):
        places = [
            (t, k)
            for t in _containers(tree)
            for k in (t if isinstance(t, dict) else range(len(t)))
        ]
        if not places:
            break
        holder, key = rng.choice(places)
        what = rng.randrange(6)
        if what < 3:
            holder[key] = hostile_value(rng)
        elif what == 3:
            del holder[key]
        elif what == 4 and isinstance(holder, list):
            holder[key:key] = [holder[key]] * rng.choice((1, 7, 3000))
        else:
            holder[key] = json.loads(
                json.dumps(rng.choice([h[k] for h, k in places]))
            )
    return tree


def hostile_value(rng: random.Random) -> Any:
    deep: Any = []
    for _ in range(rng.choice((2, 200))):
        deep = [deep] if rng.random() < 0.5 else {"a": deep}
    numbers = [
        0,
        -1,
        1,
        5120,
        5126,
        10**6,
        2**31 - 1,
        2**31,
        2**63,
        10**30,
        -(2**40),
        0.5,
        1e-300,
        1e308,
        float("nan"),
        float("inf"),
    ]
    return rng.choice(
        [
            *numbers,
            *WORDS,
            None,
            True,
            False,
            [],
            {},
            [[]],
            [None],
            [1e308] * 3,
            ["a"],
            {"a": 1},
            deep,
        ]
    )


def _containers(tree: Any) -> list[Any]:
    out = []
    if isinstance(tree, (dict, list)):
        out.append(tree)
        for value in tree.values() if isinstance(tree, dict) else tree:
            out += _containers(value)
    return out
