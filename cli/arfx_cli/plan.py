"""`arfx plan`: what `process` would do and leave out, and why; renders nothing."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from arfx_cli.console import (
    Progress,
    arfx_command,
    asks_for_json,
    detail,
    print_table,
    say,
    verbose,
    wrote_json,
)
from arfx_cli.job_options import job_config, job_options, run_options

if TYPE_CHECKING:
    from arfx.core.plan import FramePlan


@arfx_command("plan", *job_options())
def command(**given: Any) -> None:
    """Explain what `arfx process` with the same arguments would do to CLIP, with predicted
    time. Nothing is written.

    \b
    Example:
      arfx plan clip.mp4 --camera camera.yaml --marker 36h11:3:165mm --model duck.glb --fit 15cm
    """
    from arfx.plan.explain import without_price
    from arfx.run.aside import plan_document, planned_aside
    from arfx.run.model_size import size_in_words
    from arfx.run.pages import render

    with Progress() as progress:
        options = run_options(given, progress)
        with planned_aside(job_config(given), options) as job:
            document = plan_document(job)
    rows = document["stages"]
    if verbose() and asks_for_json():
        document["plans"] = [p.to_json() for p in job.plan.frames]
    if wrote_json(document):
        return
    frames = job.plan.frames
    print_table("plan/plan_table.jinja", words=2, rows=rows, frames=len(frames))
    for line in frame_by_frame(frames):
        detail(line)
    say(size_in_words(document["model"]))
    unpriced = [r["name"] for r in rows if r["predicted_s"] is None]
    text = render(
        "plan/plan_lines.jinja",
        levels=job.plan.levels,
        predicted=job.plan.predicted,
        frames=len(frames),
        unknown="; ".join(without_price(unpriced)) if unpriced else "",
    )
    say(text.rstrip())


def frame_by_frame(plans: Sequence[FramePlan]) -> Iterator[str]:
    """What runs and what does not, and why: one line for each stretch of frames that have
    the same steps and reasons.
    """

    def words(plan: FramePlan) -> str:
        skipped = [f"no {s.stage} ({s.reason})" for s in plan.skipped]
        return "; ".join(
            [
                ", ".join(f"{s.stage} {s.level}" for s in plan.steps)
                or "nothing runs",
                *skipped,
            ]
        )

    for text, group in itertools.groupby(plans, words):
        stretch = [p.index for p in group]
        yield (
            f"frame{f's {stretch[0]}–{stretch[-1]}' if len(stretch) > 1 else f' {stretch[0]}'}:"
            f" {text}"
        )
