"""That the harness sees what it is there to see, and that a case is the same wherever it
runs; `make fuzz` runs the cases.
"""

from __future__ import annotations

import dataclasses
import os
import random
import signal
import sys
from pathlib import Path

import pytest

if not sys.platform.startswith("linux"):
    pytest.skip("the harness asks /proc", allow_module_level=True)

from tests.clips import write_clip
from tests.fuzz import videos
from tests.fuzz.case import Case
from tests.fuzz.judge import Ended, judge, snapshot
from tests.fuzz.material import make
from tests.fuzz.trace import Trace, _calls
from tests.fuzz.worker import KINDS, case_of

GOOD = Ended(
    3,
    0.1,
    1 << 20,
    "",
    "note: something\nerror: clip.mp4 is no video\nhelp: give a video\n",
)


def kinds(
    case: Case,
    *ended: Ended,
    reached: tuple[tuple[str, str], ...] = (),
    before: dict[str, str] | None = None,
) -> set[str]:
    return {
        kind
        for kind, _ in judge(
            case,
            list(ended),
            snapshot(case.folder) if before is None else before,
            list(reached),
        )
    }


@pytest.mark.parametrize(
    ("changed", "kind"),
    [
        ({}, None),
        ({"code": 5}, "exit code"),
        ({"code": -11, "err": ""}, "exit code"),
        (
            {"err": "Traceback (most recent call last):\n  File\nValueError: a\n"},
            "traceback",
        ),
        ({"code": 5, "err": "error: arfx failed: KeyError: 'a'\n"}, "internal error"),
        ({"err": "error: a\nerror: b\n"}, "messages"),
        ({"err": ""}, "messages"),
        ({"err": "numpy.py:1: RuntimeWarning: overflow\nerror: a\n"}, "warning"),
        ({"code": None, "why": "hang"}, "hang"),
        ({"code": None, "why": "memory"}, "memory"),
        ({"code": 0, "err": "", "out": '{"output": {"frames": 4}}'}, "output broken"),
        ({"code": 0, "err": "", "out": '{"a": NaN}'}, "json"),
    ],
)
def test_a_bad_end_is_found(
    tmp_path: Path, changed: dict[str, object], kind: str | None
) -> None:
    ended = dataclasses.replace(GOOD, **changed)
    assert (
        (kind in kinds(Case(tmp_path, ["process", "--json"]), ended))
        if kind
        else not kinds(Case(tmp_path, []), ended)
    )


def test_files_that_come_go_or_change_are_found(tmp_path: Path) -> None:
    (tmp_path / "clip.mp4").write_bytes(b"a")
    before, case = snapshot(tmp_path), Case(tmp_path, ["process"])
    assert not kinds(case, GOOD, before=before)
    (tmp_path / "out.mp4").touch()
    assert kinds(case, GOOD, before=before) == {"output without exit 0"}
    (tmp_path / "out.mp4").rename(tmp_path / "out.mp4.part")
    assert kinds(case, GOOD, before=before) == {"file left"}
    (tmp_path / "out.mp4.part").unlink()
    (tmp_path / "clip.mp4").write_bytes(b"b")
    assert kinds(case, GOOD, before=before) == {"input changed"}
    (tmp_path / "clip.mp4").unlink()
    assert kinds(case, GOOD, before=before) == {"input changed"}


def test_a_signal_in_the_first_moments_belongs_to_the_interpreter(
    tmp_path: Path,
) -> None:
    case = Case(tmp_path, ["process"], stop=(signal.SIGINT, "time", 0.1))
    words = (
        'Traceback (most recent call last):\n  File "{}", line 7\nKeyboardInterrupt\n'
    )
    assert not kinds(
        case, Ended(1, 0.1, 0, "", words.format("/usr/lib/python3/site.py"))
    )
    assert kinds(case, Ended(1, 0.1, 0, "", words.format("/x/arfx_cli/main.py"))) == {
        "traceback",
        "exit code",
    }


def test_an_output_is_counted(tmp_path: Path) -> None:
    before = snapshot(tmp_path)
    write_clip(tmp_path / "out.mp4", 3)
    case, told = Case(tmp_path, ["process", "--json"]), '{"output": {"frames": %d}}'
    good = Ended(0, 0.1, 0, told % 3, "")
    assert not kinds(case, good, before=before)
    assert kinds(case, dataclasses.replace(good, out=told % 4), before=before) == {
        "output broken"
    }
    assert kinds(dataclasses.replace(case, expect="0"), good, before=before) == {
        "bytes differ"
    }


def test_what_is_opened_started_and_connected_to_is_found(tmp_path: Path) -> None:
    here = tmp_path / "case" / "here"
    here.mkdir(parents=True)
    (tmp_path / "case" / "outside").mkdir()
    lines = [
        f'7 openat(AT_FDCWD<{here}>, "clip.mp4", O_RDONLY) = 3<{here}/clip.mp4>',
        (
            f'7 openat(AT_FDCWD<{here}>, "../outside/a\\303\\244.png", O_RDONLY) = -1'
            " ENOENT (No such file or directory)"
        ),
        '8 openat(AT_FDCWD</>, "/etc/hostname", O_RDONLY|O_CLOEXEC <unfinished ...>',
        '8 openat(AT_FDCWD</>, "/usr/lib/libc.so.6", O_RDONLY|O_CLOEXEC) = 3',
        (
            '9 execve("/usr/bin/gs", ["gs"], 0x7ffd /* 12 vars */) = -1 ENOENT (No such'
            " file or directory)"
        ),
        (
            "9 connect(3<socket:[1]>, {sa_family=AF_INET, sin_port=htons(9),"
            ' sin_addr=inet_addr("127.0.0.1")}, 16) = -1 ECONNREFUSED'
        ),
        f'{os.getpid()} openat(AT_FDCWD</>, "/etc/shadow", O_RDONLY) = 3',
    ]
    log = tmp_path.with_name(f"{tmp_path.name}.strace")
    log.write_text("".join(f"{line}\n" for line in lines))
    assert len(list(_calls([line.encode() for line in lines]))) == 6, (
        "the worker's own lines are left out"
    )
    found = Trace(tmp_path).read(Case(here, ["process", "clip.mp4"]))
    outside = str(tmp_path / "case" / "outside" / "aä.png")
    assert found == [
        ("connect", "AF_INET sin_port=htons(9)"),
        ("exec", "/usr/bin/gs"),
        ("open", "/etc/hostname"),
        ("open", outside),
    ]
    assert ("open", "/etc/hostname") not in Trace(tmp_path).read(
        Case(here, ["process", "--camera=/etc/hostname"])
    ), "asked for"


def test_a_case_is_the_same_wherever_it_runs(tmp_path: Path) -> None:
    material = make(tmp_path)
    (material / "long.json").write_text(
        '{"digest": "", "short": "", "placed": 50, "events": 65, "seconds": 1.0,'
        ' "cold_seconds": 1.0}'
    )
    names = [f"5:{i}:{kind}" for kind in KINDS for i in range(4)] + [
        f"{kind}/{next(iter(KINDS[kind][0].SEEDS))}" for kind in KINDS
    ]
    for name in names:
        built = []
        for turn in ("a", "b"):
            folder = tmp_path / turn / "here"
            folder.mkdir(parents=True)
            case = case_of(name, folder, material)
            same = [word.replace(f"/{turn}/", "/x/") for word in case.args]
            files = {
                k: v.replace(f"/{turn}/", "/x/") for k, v in snapshot(folder).items()
            }
            built.append((same, files, case.codes, case.stop))
            folder.rename(tmp_path / turn / name.replace("/", "-"))
        assert built[0] == built[1] or videos.SEEDS.keys() & {name}, name
    assert random.Random("5:0").random() == random.Random("5:0").random()
