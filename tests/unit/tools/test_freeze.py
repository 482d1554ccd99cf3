"""tools/freeze.py: two equal states have no difference, and each kind of change is found
and listed.
"""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from tools.freeze import compare, read_expected
from tools.freeze_compare import compare_jobs

FACTS = {
    "index": 0,
    "camera_from_world": [0.1, 0.2, 0.3, 0.0, 0.0, 0.5],
    "light": {"ambient_rgb": [0.4, 0.5, 0.6]},
}
PLAN = {
    "index": 0,
    "changed": [8, 8, 24, 24],
    "steps": [{"stage": "raster", "level": "standard", "reason": "in view"}],
}
STAGE = {"name": "raster", "predicted_s": 1.0, "measured_s": 2.0}
TIMES = (0, 40, 80)


def write_clip(
    path: Path,
    change: Callable[[int, np.ndarray], None] | None = None,
    times: tuple[int, ...] = TIMES,
) -> Path:
    with av.open(str(path), "w") as out:
        stream = out.add_stream("ffv1", rate=25)
        stream.width, stream.height, stream.pix_fmt = 32, 32, "gray"
        stream.time_base = stream.codec_context.time_base = Fraction(1, 1000)
        for number, pts in enumerate(times):
            picture = np.full((32, 32), 100 + number, np.uint8)
            if change is not None:
                change(number, picture)
            frame = av.VideoFrame.from_ndarray(picture, format="gray")
            frame.pts, frame.time_base = pts, Fraction(1, 1000)
            out.mux(stream.encode(frame))
        out.mux(stream.encode(None))
    return path


def render(number: int, picture: np.ndarray) -> None:
    picture[10:20, 10:20] = 200


def write_job(folder: Path, source: Path, **changes: Any) -> Path:
    folder.mkdir(parents=True)
    report = {
        "input": {"path": str(source), "rotation": 0},
        "stages": [STAGE],
        "timing": {"wall_s": 1.0},
    }
    texts = {"call.json": {"exit": 0, "output": "a line\n"}, "report.json": report}
    for name, document in {
        **texts,
        **{k: v for k, v in changes.items() if k.endswith(".json")},
    }.items():
        (folder / name).write_text(json.dumps(document))
    (folder / "facts.jsonl").write_text(json.dumps(changes.get("facts", FACTS)))
    (folder / "plan.jsonl").write_text(
        "\n".join(json.dumps(changes.get("plan", PLAN)) for _ in TIMES)
    )
    write_clip(
        folder / "out.mkv",
        changes.get("picture", render),
        changes.get("times", TIMES),
    )
    return folder


def changed(document: dict[str, Any], value: Any, *keys: Any) -> dict[str, Any]:
    out = copy.deepcopy(document)
    place: Any = out
    for key in keys[:-1]:
        place = place[key]
    place[keys[-1]] = value
    return out


def outside(number: int, picture: np.ndarray) -> None:
    render(number, picture)
    picture[2, 2] += 1


def inside(number: int, picture: np.ndarray) -> None:
    render(number, picture)
    picture[10:20, 10:20] += 2


CHANGES = {
    "facts[*].camera_from_world[*]": {
        "facts": changed(FACTS, 0.100002, "camera_from_world", 0)
    },
    "facts[*].light.ambient_rgb[*]": {
        "facts": changed(FACTS, 0.401, "light", "ambient_rgb", 0)
    },
    "plan[*].steps[*].reason": {"plan": changed(PLAN, "near", "steps", 0, "reason")},
    "plan[*].steps[*].level": {"plan": changed(PLAN, "draft", "steps", 0, "level")},
    "plan[*].changed[*]": {"plan": changed(PLAN, 25, "changed", 2)},
    "call.exit": {"call.json": {"exit": 3, "output": "a line\n"}},
    "call.output[*]": {"call.json": {"exit": 0, "output": "a lime\n"}},
    "pixels.untouched": {"picture": outside},
    "pixels.touched": {"picture": inside},
    "times": {"times": (0, 40, 81)},
    "frames": {"times": (0, 40)},
}


@pytest.mark.parametrize("where", CHANGES)
def test_each_kind_of_change_is_found(tmp_path: Path, where: str) -> None:
    source = write_clip(tmp_path / "source.mkv")
    old = write_job(tmp_path / "old", source)
    found = compare_jobs(old, write_job(tmp_path / "new", source, **CHANGES[where]))
    assert where in {d.where for d in found}, found


def test_equal_states_and_what_may_vary(tmp_path: Path) -> None:
    source = write_clip(tmp_path / "source.mkv")
    old = write_job(tmp_path / "old", source)
    assert compare_jobs(old, write_job(tmp_path / "same", source)) == []
    report = json.loads((old / "report.json").read_text())
    later = changed(
        report, [{**STAGE, "predicted_s": 1.02, "measured_s": 9.0}], "stages"
    )
    assert (
        compare_jobs(
            old, write_job(tmp_path / "later", source, **{"report.json": later})
        )
        == []
    )
    dearer = changed(report, [{**STAGE, "predicted_s": 1.05}], "stages")
    found = compare_jobs(
        old, write_job(tmp_path / "dearer", source, **{"report.json": dearer})
    )
    assert [d.where for d in found] == ["report.stages[*].predicted_s"]


def test_expected_changes_need_a_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = write_clip(tmp_path / "source.mkv")
    write_job(tmp_path / "a" / "job", source)
    write_job(
        tmp_path / "b" / "job",
        source,
        facts=changed(FACTS, 0.401, "light", "ambient_rgb", 0),
    )
    rules = tmp_path / "expected.txt"
    rules.write_text("# of this change\njob | facts*light* | the lamp is brighter\n")
    assert compare(tmp_path / "a", tmp_path / "b", None) == 1
    assert compare(tmp_path / "a", tmp_path / "b", rules) == 0
    assert "(expected)" in capsys.readouterr().out
    rules.write_text("job | facts*\n")
    with pytest.raises(SystemExit, match="line 1"):
        read_expected(rules)
