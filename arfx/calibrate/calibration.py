"""Pictures of a board in, a camera with its uncertainty and a verdict out; all of it as one
JSON-able document, and as extras of the camera file."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from arfx.calibrate.advice import (
    Coverage,
    Verdict,
    coverage,
    figures,
    judge,
    next_picture,
    projection_uncertainty_px,
)
from arfx.calibrate.board import CHARUCO, BoardSpec
from arfx.calibrate.corners import View, find_view, seen_instead
from arfx.calibrate.screen import (
    Rejected,
    drop_copies,
    drop_corners,
    most_varied,
    reject_views,
)
from arfx.calibrate.solve import Evidence, Fit, Uncertainty, choose_model, uncertainty
from arfx.errors import InputError, NothingToDoError

KEEP_VIEWS = 40  # more add little (errors fall with the root) and cost linearly
# EXIF's orientations of a camera held the other way up than by 1, 2, 5 and 6
UPSIDE_DOWN = (3, 4, 7, 8)
LOOKED_AT = 4  # pictures without the board that are searched for other boards


class Picture(NamedTuple):
    """gray : (h, w) uint8 upright, or why it cannot be read;  turn : EXIF's orientation"""

    name: str
    gray: ndarray | InputError
    turn: int = 1


class Found(NamedTuple):
    """Detection's result. spec : the board, its pattern corrected where the pictures say
    so; searched : pictures looked at;
    empty : names of those without the board, with what was seen there; notices : for the user
    """

    spec: BoardSpec
    views: tuple[View, ...]
    searched: int
    empty: tuple[str, ...]
    instead: tuple[str, ...]
    notices: tuple[str, ...]


class Calibration(NamedTuple):
    """fitted, known, seen : solution, its uncertainty, coverage; evidence : every lens model's
    showing"""

    fitted: Fit
    known: Uncertainty
    seen: Coverage
    projection_sd_px: ndarray
    chosen: Evidence
    evidence: tuple[Evidence, ...]
    verdict: Verdict
    figures: dict[str, float]
    found: Found
    copies: tuple[Rejected, ...]
    rejected: tuple[Rejected, ...]
    upside_down: tuple[str, ...]
    notices: tuple[str, ...]


def find_board(
    pictures: Iterable[Picture],
    spec: BoardSpec,
    progress: Callable[[int, int], None] = lambda *_: None,
) -> Found:
    """Search pictures for the board. Those that cannot be read, or are not of the camera's
    usual size and orientation, are left out with a notice.

    progress : called with pictures searched and boards found
    Raises InputError where none can be read, or no size and orientation is that of most;
    NothingToDoError, saying what is seen instead, if no board is found."""
    views, empty, notices = list[View](), list[str](), list[str]()
    unread = list[InputError]()
    kinds: dict[str, list[str]] = defaultdict(list)
    samples: list[tuple[str, ndarray]] = []
    searched = 0
    for name, gray, turn in pictures:
        if isinstance(gray, InputError):
            unread.append(gray)
            continue
        upside_down = " upside down by EXIF" * (turn in UPSIDE_DOWN)
        kinds[f"{gray.shape[1]}x{gray.shape[0]}{upside_down}"].append(name)
        searched += 1
        view = find_view(gray, spec, name)
        if view is None and spec.kind == CHARUCO and not views:
            other = replace(spec, legacy=not spec.legacy)
            view = find_view(gray, other, name)
            if view is not None:
                pattern = "legacy" if other.legacy else "new"
                notices.append(
                    f"the board has the {pattern} pattern: {other}, not {spec}"
                )
                spec = other
        if view is not None:
            views.append(view)
        else:
            empty.append(name)
            if len(samples) < LOOKED_AT:
                samples.append((name, gray))
        progress(searched, len(views))
    bad = "; ".join(e.message for e in unread)
    hints = "; ".join(dict.fromkeys(e.hint for e in unread))
    if bad and not searched:
        raise InputError(bad, hints)
    if bad:
        notices.append(f"left out: {bad} ({hints})")
    if not searched:
        raise NothingToDoError(
            "no pictures to search", "give images or a video of the board"
        )
    usual = _usual_kind(kinds, notices)
    views = [v for v in views if v.name in usual]
    instead = tuple(
        f"{name}: {what}"
        for name, gray in samples
        if (what := seen_instead(gray, spec))
    )
    if not views:
        saw = "no other board or marker either"
        if instead:
            saw = "instead " + "; ".join(instead)
        raise NothingToDoError(
            f"board {spec} is in none of {searched} pictures; "
            + "; ".join([saw, *notices]),
            "give the --board that was printed; a chessboard must be wholly in the picture,"
            " with a white margin",
        )
    if instead:
        notices.append(
            "mixed boards or markers: " + "; ".join(instead) + " (not used)"
        )
    return Found(spec, tuple(views), searched, tuple(empty), instead, tuple(notices))


def _usual_kind(
    kinds: Mapping[str, Sequence[str]], notices: list[str]
) -> Sequence[str]:
    """Names of the pictures of the usual size, held as the others; a notice says which are not.

    kinds : names by size and orientation. Raises InputError where no kind is that of most.
    """
    usual = max(kinds.values(), key=len)
    words = ", ".join(
        f"{_first_names(names)} {'is' if len(names) == 1 else 'are'} {kind}"
        for kind, names in kinds.items()
    )
    if 2 * len(usual) <= sum(map(len, kinds.values())) and len(kinds) > 1:
        raise InputError(
            f"pictures of different sizes or orientations: {words}",
            "a calibration belongs to one size and orientation: give those of one camera"
            " mode, held one way (if they are, their EXIF orientations are wrong:"
            " exiftool -Orientation=1 -n mends the tags)",
        )
    if len(kinds) > 1:
        notices.append(f"pictures of the most frequent kind alone are used: {words}")
    return usual


def calibrate(found: Found) -> Calibration:
    """Intrinsics from the views found.

    Raises NothingToDoError if fewer than three different views agree.
    """
    notices = list(found.notices)
    unique, copies = drop_copies(found.views)
    unique = most_varied(unique, KEEP_VIEWS)
    if len(unique) < 3:
        raise NothingToDoError(
            f"board {found.spec} is seen in {len(found.views)} of {found.searched}"
            f" pictures, {len(unique)} of them different"
            + "".join(f"; {n}" for n in found.notices),
            "at least 3 different views are needed, 15 are good",
        )
    # twice: with a rich model the views' errors are smaller, and a bad view stands out that
    # hid behind the lens's distortion
    first_fit, _ = reject_views(unique)
    chosen, _ = choose_model(first_fit.views)
    again, rejected = reject_views(unique, chosen.model)
    trimmed = drop_corners(again)
    chosen, table = choose_model(trimmed)
    fitted = chosen.fitted or again
    before, after = (sum(len(v.ids) for v in some) for some in (again.views, trimmed))
    known = uncertainty(fitted)
    seen = coverage(fitted)
    projection = projection_uncertainty_px(fitted, known)
    measured = figures(
        fitted, seen, known, projection, chosen.held_out_rms_px, len(rejected)
    )
    word, reasons = judge(measured)
    usually = float(np.mean([v.upside_down for v in fitted.views])) > 0.5
    turned = tuple(v.name for v in fitted.views if v.upside_down != usually)
    if copies:
        notices.append(
            f"{len(copies)} views are copies of others and count once:"
            f" {_first_names([c.name for c in copies])}"
        )
    notices += [f"{r.name} is left out: {r.reason}" for r in rejected]
    if turned:
        notices.append(
            f"{len(turned)} views show the board upside down (corners renumbered):"
            f" {_first_names(turned)}"
        )
    if found.empty:
        notices.append(
            f"no board in {len(found.empty)} of {found.searched} pictures:"
            f" {_first_names(found.empty)}"
        )
    if before > after:
        notices.append(f"{before - after} corners miss by far and are left out")
    verdict = Verdict(word, reasons, next_picture(seen))
    return Calibration(
        fitted,
        known,
        seen,
        projection,
        chosen,
        tuple(table),
        verdict,
        measured,
        found,
        tuple(copies),
        tuple(rejected),
        turned,
        tuple(notices),
    )


def _first_names(names: Sequence[str]) -> str:
    more = f" and {len(names) - 5} more" * (len(names) > 5)
    return ", ".join(names[:5]) + more


def document(result: Calibration) -> dict[str, Any]:
    """Everything that was found out.

    Lengths in px unless named otherwise; `camera_matrix` 3x3 nested.
    """
    fitted, known, seen, found = (
        result.fitted,
        result.known,
        result.seen,
        result.found,
    )
    camera, sd = fitted.camera, result.projection_sd_px

    return {
        "verdict": result.verdict.word,
        "reasons": list(result.verdict.reasons),
        "next_picture": result.verdict.next_picture,
        "notices": list(result.notices),
        "board": str(found.spec),
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_matrix": camera.matrix.tolist(),
        "distortion_coefficients": camera.distortion.tolist(),
        "lens_model": fitted.model.name,
        "standard_deviations": dict(
            zip(
                fitted.model.parameters,
                known.standard_deviations.tolist(),
                strict=True,
            )
        ),
        "reprojection_rms_px": fitted.rms_px,
        "held_out_rms_px": result.chosen.held_out_rms_px,
        "corner_noise_px": fitted.noise_px,
        "condition": known.condition,
        "projection_sd_px": {
            "median": float(np.median(sd)),
            "p90": float(np.quantile(sd, 0.9)),
            "worst": float(sd.max()),
        },
        "models": [
            {
                "model": e.model.name,
                "held_out_rms_px": e.held_out_rms_px,
                "chosen": e is result.chosen,
                "rejected": e.rejected,
                "fx": e.fitted.camera.fx if e.fitted else None,
                "rms_px": e.fitted.rms_px if e.fitted else None,
            }
            for e in result.evidence
        ],
        "coverage": {
            "cells": seen.cells,
            "counts": seen.counts.tolist(),
            "radius": seen.radius,
            "tilt_max_deg": float(seen.tilt_deg.max()),
            "tilt_directions": seen.directions,
        },
        "figures": result.figures,
        "pictures": {
            "searched": found.searched,
            "with_board": len(found.views),
            "used": len(fitted.views),
            "without_board": list(found.empty),
            "other_boards": list(found.instead),
            "copies": [view._asdict() for view in result.copies],
            "rejected": [view._asdict() for view in result.rejected],
            "upside_down": list(result.upside_down),
        },
        "views": [
            {
                "name": v.name,
                "corners": len(v.ids),
                "finder": v.finder,
                "rms_px": float(fitted.view_rms_px[i]),
                "held_out_rms_px": float(result.chosen.held_out_px[i]),
                "tilt_deg": float(seen.tilt_deg[i]),
                "tilt_towards_deg": float(seen.azimuth_deg[i]),
                "sharpness": v.sharpness,
            }
            for i, v in enumerate(fitted.views)
        ],
    }


def file_extras(result: Calibration) -> dict[str, Any]:
    """What the camera file holds besides the camera."""
    d = document(result)
    keys = (
        "verdict",
        "reasons",
        "board",
        "lens_model",
        "standard_deviations",
        "reprojection_rms_px",
        "held_out_rms_px",
    )
    return {k: d[k] for k in keys} | {"views_used": len(result.fitted.views)}
