"""Whether a case ended as it may: exit code, messages, files, time, memory, and nothing
opened that is none of its business.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import signal
import stat
from dataclasses import dataclass
from pathlib import Path

import av

from arfx.media.output import names_sequence
from tests.fuzz.case import Case

Found = list[tuple[str, str]]
STOPPED = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGKILL: -9}


@dataclass
class Ended:
    """How a command ended. code : None = this harness killed it, for the reason `why`
    ("memory", "hang")

    sent : when it was sent a signal from outside, None = it was not
    """

    code: int | None
    seconds: float
    most_bytes: int
    out: str
    err: str
    why: str = ""
    sent: float | None = None


def snapshot(folder: Path) -> dict[str, str]:
    """What lies in a folder: path -> digest, target of a link, or kind."""
    out = {}
    for top, folders, files in os.walk(folder):
        for name in (*folders, *files):
            path = f"{top}/{name}"
            mode = os.lstat(path).st_mode
            key = os.path.relpath(path, folder)
            if stat.S_ISREG(mode):
                out[key] = hashlib.md5(Path(path).read_bytes()).hexdigest()
            else:
                out[key] = (
                    str(Path(path).readlink())
                    if stat.S_ISLNK(mode)
                    else str(stat.S_IFMT(mode))
                )
    return out


def judge(
    case: Case, ended: list[Ended], before: dict[str, str], reached: Found
) -> Found:
    """All that is wrong, as (kind, words)."""
    found: Found = [
        (e.why, f"{e.seconds:.0f} s, {e.most_bytes >> 20} MB") for e in ended if e.why
    ]
    kinds = {"open": "read outside", "exec": "process", "connect": "connection"}
    found += [(kinds[what], which) for what, which in reached]
    last = ended[-1]
    if any(e.why for e in ended):
        return found
    for e in ended:
        found += _messages(case, e)
    after = snapshot(case.folder)
    there = os.path.normpath(case.output or "-") in after
    judged = ended if case.stop is None else ended[1:]
    if (
        case.stop_again is not None
        and ended[1:]
        and ended[1].code == -case.stop_again[0]
    ):
        judged = ended[2:]
    found += [
        ("exit code", f"{e.code}: {_first(e.err)}")
        for e in judged
        if e.code not in case.codes
    ]
    if case.stop is not None:
        found += _stopped(case, ended[0], there and len(ended) == 1)
    looked = 0 in [e.code for e in ended] or ((case.silent or case.stop) and there)
    return (
        found
        + _files(case, ended, before, after)
        + (_output(case, last) if looked else [])
    )


def _messages(case: Case, e: Ended) -> Found:
    found: Found = []
    if "Traceback (most recent" in e.err and not before_arfx(e):
        found.append(("traceback", e.err.strip().splitlines()[-1]))
    if "arfx failed" in e.err:
        found.append(("internal error", _first(e.err)))
    if warnings := re.findall(r"\w+Warning: .*", e.err):
        found.append(("warning", warnings[0]))
    if case.silent or case.stop is not None:
        return found
    errors = len(re.findall(r"^error: ", e.err, re.MULTILINE | re.IGNORECASE))
    if e.code is not None and e.code >= 0 and errors != (e.code != 0):
        found.append(("messages", f"{errors} at exit {e.code}: {_first(e.err)}"))
    if e.code == 0 and "--json" in case.args and case.after is None:
        try:
            json.loads(e.out, parse_constant=_no_number)
        except ValueError as error:
            found.append(("json", f"{error}: {e.out[:100]!r}"))
    return found


def before_arfx(e: Ended) -> bool:
    """Whether the interpreter itself was interrupted while it started (in `site`, say),
    which it ends with a traceback.
    """
    return (
        e.code in (1, -2)
        and "KeyboardInterrupt" in e.err
        and not re.search(r'File ".*arfx', e.err)
    )


def _no_number(text: str) -> None:
    raise ValueError(f"{text} is no JSON")


def _stopped(case: Case, first: Ended, there: bool) -> Found:
    """After a signal the exit code says whether the output is complete: 0 = it is, 130 and
    143 = there is none.
    """
    assert case.stop is not None
    number = signal.Signals(case.stop[0])
    if first.code == 0 and not there:
        return [("exit code", f"{number.name}: 0 without the output")]
    # the interpreter's first moments belong to nobody: then the signal itself ends the
    # process, before there is anything
    allowed = (
        {0, STOPPED[number]}
        | (set() if there else {-number})
        | ({1} if before_arfx(first) else set())
    )
    if first.code not in allowed:
        return [("exit code", f"{number.name}: {first.code}: {_first(first.err)}")]
    # put in place long after: the signal was lost; a busy machine may take a while over
    # what was begun
    if (
        first.code == 0
        and first.sent
        and (case.folder / "out.mp4").stat().st_ctime > first.sent + 2
    ):
        return [("signal lost", number.name)]
    if there and first.code not in (0, -9):
        return [
            ("exit code", f"{number.name}: {first.code}, and the output is there")
        ]
    return []


def _files(
    case: Case, ended: list[Ended], before: dict[str, str], after: dict[str, str]
) -> Found:
    codes = [e.code for e in ended]
    output = os.path.normpath(case.output or "-")
    wrote = 0 in codes and case.output is not None
    found: Found = []
    for path, was in before.items():
        if after.get(path) != was and not (
            wrote and "--overwrite" in case.args and path == output
        ):
            found.append(
                (
                    "input changed",
                    f"{path}: {'gone' if path not in after else 'other'}",
                )
            )
    numbered = re.sub(
        r"%0?\d*d", lambda _: r"\d+", re.escape(output.replace("%%", "\0"))
    ).replace(re.escape("\0"), "%")
    resumable = (
        case.keeps
        or case.lost
        or case.beside
        or case.stop
        or {5, 130, 143} & set(codes)
    )
    for path in sorted(set(after) - set(before)):
        top = path.partition(os.sep)[0]
        if wrote and (
            re.fullmatch(numbered, path)
            or path == output
            or Path(path).name == "times.txt"
            or output.startswith(path + os.sep)
        ):
            continue
        if (
            path in case.leaves
            or top in case.leaves
            or (resumable and ".job" in path)
        ):
            continue
        if path == output and (
            case.silent or case.stop
        ):  # it is complete, which _output looks at
            continue
        found.append(
            ("output without exit 0" if path == output else "file left", path)
        )
        break
    return found


def _output(case: Case, last: Ended) -> Found:
    if case.output is None or case.lost:
        return []
    path = case.folder / case.output
    if case.stop is not None or case.expect is not None:
        whole = (
            path.exists()
            and hashlib.blake2b(path.read_bytes(), digest_size=16).hexdigest()
            == case.expect
        )
        return [] if whole else [("bytes differ", case.note)]
    try:
        told = json.loads(last.out)["output"]
        wanted = int(told["frames"])
    except (ValueError, KeyError, TypeError):
        return (
            []
            if case.silent or case.after is not None
            else [("json", f"no count of frames: {last.out[:100]!r}")]
        )
    try:
        if names_sequence(path):
            held = sum(
                1
                for p in path.parent.glob(f"*{path.suffix}")
                if p.stat().st_size > 60 and p.name not in case.args
            )
        else:
            with av.open(f"file:{path}", metadata_errors="replace") as c:
                held = sum(1 for _ in c.decode(video=0))
    except (OSError, av.FFmpegError, IndexError) as e:
        return [("output broken", str(e))]
    return (
        [] if held == wanted else [("output broken", f"{held} frames, {wanted} told")]
    )


def _first(text: str) -> str:
    lines = [
        line for line in text.splitlines() if re.match("error: ", line, re.IGNORECASE)
    ] or text.splitlines()[-1:]
    return lines[0][:300] if lines else ""


def signature(found: tuple[str, str]) -> str:
    """Findings of one cause, as far as words tell: numbers, names and addresses are left out."""
    return (
        f"{found[0]}:"
        f" {re.sub(r'[0-9][0-9.e+-]*|/[^ ]*|(?<= )[^ ]*[.][a-z0-9]+', '#', found[1])[:110]}"
    )
