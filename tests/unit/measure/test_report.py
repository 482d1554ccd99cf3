"""report.html is self-contained and escaped, report.json is strict, and an unfinished job
is said to be one.
"""

from __future__ import annotations

import base64
import copy
import html.parser
import json
import math
import os
import re
from pathlib import Path

import numpy as np
import pytest

from arfx.core.camera import Camera
from arfx.core.facts import ABSENT, INTERPOLATED, MEASURED, FrameFacts, MarkerSighting
from arfx.core.pose import Pose
from arfx.errors import InputError, RenderError
from arfx.measure.report import finite, read_report, write_report
from arfx.run.pages import number, render

REPORT = {
    "input": {"path": "/clips/a<b>&.mp4", "frames": 6, "seconds": 0.2, "width": 64, "height": 48, "fps": 30.0, "vfr": False,
              "rotation": 0, "audio": ["aac"], "stream": {"codec": "secret detail"}},
    "output": {"path": "out.mp4", "frames": 6, "seconds": 0.2, "bytes": 12345},
    "pose": {"frames_measured": 4, "frames_interpolated": 1, "frames_absent": 1, "jitter_px": 0.05,
             "jitter_before_smoothing_px": 0.4, "reprojection_px": {"median": 0.21, "p95": math.nan}, "flips_resolved": 2},
    "light": {"source": "marker", "verdict": "likely", "reason": "two lamps up to 30 degrees apart", "spans": [
        {"start_s": 0.0, "end_s": 0.1, "verdict": "likely", "lights": [{"rgb": [0.5, 0.4, 0.3]}],
         "ambient_rgb": [0.1] * 3, "reason": "on"},
        {"start_s": 0.1, "end_s": 0.2, "verdict": "likely", "lights": [], "ambient_rgb": [0.1] * 3, "reason": "off"}]},
    "stages": [{"name": "raster", "levels": {"standard": 5}, "frames_run": 5, "frames_skipped": 1, "area_fraction": 0.1,
                "predicted_s": None, "measured_s": 1.25, "reasons": {"marker <not> visible": 1}}],
    "health": [{"check": "pose condition number", "value": 1e7, "limit": 1e6, "verdict": "warn", "action": "larger marker"}],
    "timing": {"decode_s": 0.1, "analyse_s": 0.2, "render_s": 1.0, "encode_s": 0.3, "wall_s": 1.8, "frames_per_s": 3.3,
               "peak_rss_mb": 200.0},
    "notices": ["<script>alert(1)</script>"],
}  # fmt: skip


def camera() -> Camera:
    return Camera(640, 480, np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]))


def frame_facts(
    x_m: float, index: int, status: str = MEASURED, marker_px: float = 0.0
) -> FrameFacts:
    pose = None if status == ABSENT else Pose(np.eye(3), np.array([x_m, 0.0, 1.0]))
    seen = MarkerSighting(
        "36h11:3",
        np.array([[0.0, 0], [10, 0], [10, 10], [0, 10]]) + np.array([marker_px, 0]),
        0.1,
    )
    return FrameFacts(
        index, index / 30, status=status, camera_from_world=pose, raw_camera_from_world=pose, reprojection_px=0.2,
        opacity=float(status != ABSENT), markers=(seen,),
    )  # fmt: skip


def six() -> list[FrameFacts]:
    status = [MEASURED] * 3 + [INTERPOLATED, MEASURED, ABSENT]
    return [frame_facts(0.001 * i * i, i, s) for i, s in enumerate(status)]


def pictures() -> list[tuple[int, np.ndarray, np.ndarray]]:
    before = np.full((48, 64, 3), 90, np.uint8)
    after = before.copy()
    after[10:20, 10:30] = (255, 0, 0)
    return [(0, before, after), (3, before, after)]


class Links(html.parser.HTMLParser):
    """Collects every address in the page and the tags that are open at the end."""

    VOID = frozenset({"meta", "img", "input", "br"})

    def __init__(self) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.addresses += [
            v or ""
            for k, v in attrs
            if k in ("src", "href", "srcset", "action", "data")
        ]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open and self.open.pop() == tag, (
            f"</{tag}> closes another element"
        )


def test_the_page_is_self_contained_escaped_and_well_formed(tmp_path: Path) -> None:
    cube = np.array([[0.0, 0, 0], [0.1, 0, 0]])
    path = write_report(
        tmp_path / "new" / "rep", REPORT, six(), pictures(), camera(), cube
    )
    text = path.read_text()
    links = Links()
    links.feed(text)
    assert not links.open
    assert links.addresses and all(
        a.startswith("data:image/") for a in links.addresses
    )
    assert "http://" not in text and "https://" not in text and "url(" not in text
    assert "<script>alert" not in text and "&lt;script&gt;alert(1)" in text
    assert "a&lt;b&gt;&amp;.mp4" in text and "marker &lt;not&gt; visible" in text
    assert "secret detail" not in text
    assert len(
        [a for a in links.addresses if a.startswith("data:image/jpeg")]
    ) == 2 * len(pictures())


def test_the_pictures_in_the_page_are_the_given_ones(tmp_path: Path) -> None:
    import cv2

    text = write_report(tmp_path, REPORT, six(), pictures()).read_text()
    data = re.findall(
        r'class="(in|out)"[^>]*src="data:image/jpeg;base64,([^"]+)"', text
    )
    assert [kind for kind, _ in data] == ["out", "in"] * 2
    for kind, encoded in data:
        rgb = cv2.imdecode(
            np.frombuffer(base64.b64decode(encoded), np.uint8), cv2.IMREAD_COLOR
        )[..., ::-1].astype(int)
        wanted = (255, 0, 0) if kind == "out" else (90, 90, 90)
        assert np.abs(rgb[15, 20] - wanted).max() < 12


def test_the_document_is_written_strictly_and_unchanged(tmp_path: Path) -> None:
    given = copy.deepcopy(REPORT)
    write_report(tmp_path, REPORT, six(), pictures())
    read = json.loads(
        (tmp_path / "report.json").read_text(),
        parse_constant=lambda c: pytest.fail(f"{c} is no JSON"),
    )
    assert read["pose"]["reprojection_px"] == {"median": 0.21, "p95": None}
    assert read["input"] == REPORT["input"]
    assert str(given) == str(REPORT)
    assert not list(tmp_path.glob("*.part"))


@pytest.mark.parametrize(
    "facts",
    [[], [frame_facts(0, 0)], [frame_facts(0, i, ABSENT) for i in range(4)]],
    ids=["0", "1", "absent"],
)
def test_short_and_empty_clips_get_a_report(
    tmp_path: Path, facts: list[FrameFacts]
) -> None:
    assert (
        "kept no pictures"
        in write_report(
            tmp_path, REPORT, facts, [], camera(), np.zeros((1, 3))
        ).read_text()
    )


def test_a_place_that_cannot_be_written_is_one_clear_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RenderError, match="cannot be made"):
        write_report(tmp_path / "file" / "rep", REPORT, six(), [])


def test_folders_that_hold_no_finished_job_are_told_apart(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no job folder"):
        read_report(tmp_path / "none")
    with pytest.raises(InputError, match="not a job folder"):
        read_report(tmp_path)
    (tmp_path / "job.toml").write_text("")
    with pytest.raises(InputError, match="not finished") as e:
        read_report(tmp_path)
    assert "--resume" in e.value.hint
    for text in ("{", "[]", "{}"):
        (tmp_path / "report.json").write_text(text)
        with pytest.raises(InputError, match=r"report\.json"):
            read_report(tmp_path)


def test_numbers_read_well() -> None:
    assert [number(v) for v in (None, True, 0.123456, 1234.5, [1.0, 2], {"a": 0.5}, "x", [])] == [
        "–", "yes", "0.123", "1234", "1, 2", "a 0.5", "x", "–",
    ]  # fmt: skip
    assert finite(
        {"a": [math.inf, np.float32(1.5), np.array([1, 2])], 3: (math.nan,)}
    ) == {
        "a": [None, 1.5, [1, 2]],
        "3": [None],
    }


@pytest.mark.skipif(
    not hasattr(os, "mkfifo"), reason="this system has no pipes with names"
)
def test_a_pipe_in_a_job_folder_is_not_waited_for(tmp_path: Path) -> None:
    (tmp_path / "job.toml").write_text("")
    os.mkfifo(tmp_path / "report.json")
    with pytest.raises(InputError, match=r"report\.json"):
        read_report(tmp_path)


def test_a_likely_light_is_told_with_its_doubt_and_its_spans(tmp_path: Path) -> None:
    text = write_report(tmp_path, REPORT, six(), []).read_text()
    assert (
        "Likely: the simplest light" in text
        and "two lamps up to 30 degrees apart" in text
    )
    assert "0.10 – 0.20" in text and "0.5, 0.4, 0.3" in text


def test_what_controls_a_template_or_a_terminal_is_text() -> None:
    page = render("measure/page.html", title="{{ title }} <b>\x1b[2J")
    assert "<title>{{ title }} &lt;b&gt;\\x1b[2J</title>" in page
