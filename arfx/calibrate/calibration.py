"""Pictures of a board in, a camera with its uncertainty and a verdict out."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from arfx.calibrate.advice import (
    Coverage,
    Verdict,
    coverage,
    figures,
    judge,
    next_picture,
    projection_uncertainty_px,
)
from arfx.calibrate.board import CHARUCO, CHESSBOARD, BoardSpec
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
UPSIDE_DOWN = (
    3,
    4,
    7,
    8,
)  # EXIF's orientations of a camera held the other way up than by 1, 2, 5 and 6
LOOKED_AT = 4  # pictures without the board that are searched for other boards


class Picture(NamedTuple):
    """gray : (h, w) uint8 upright, or why it cannot be read;  turn : EXIF's orientation"""

    name: str
    gray: np.ndarray | InputError
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

    spec: BoardSpec
    fitted: Fit
    known: Uncertainty
    seen: Coverage
    projection_sd_px: np.ndarray
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
    damage: dict[str, list[tuple[str, str]]] = defaultdict(list)
    samples: list[tuple[str, np.ndarray]] = []
    kinds: dict[str, tuple[int, int, int]] = {}
    searched = 0
    for name, gray, turn in pictures:
        if isinstance(gray, InputError):
            damage[gray.hint].append((name, gray.message))
            continue
        kinds[name] = (gray.shape[1], gray.shape[0], turn)
        searched += 1
        view = find_view(gray, spec, name)
        if view is None and spec.kind == CHARUCO and not views:
            other = replace(spec, legacy=not spec.legacy)
            view = find_view(gray, other, name)
            if view is not None:
                was, spec = spec, other
                notices.append(
                    f"the board has the {'legacy' if spec.legacy else 'new'} pattern:"
                    f" {spec}, not {was}"
                )
        if view is None:
            empty.append(name)
            if len(samples) < LOOKED_AT:
                samples.append((name, gray))
        else:
            views.append(view)
        progress(searched, len(views))
    bad = [
        "; likewise ".join([rows[0][1], *(name for name, _ in rows[1:])])
        for rows in damage.values()
    ]
    if bad and not kinds:
        raise InputError("; ".join(bad), "; ".join(damage))
    notices += [
        f"left out: {text} ({hint})" for text, hint in zip(bad, damage, strict=True)
    ]
    others = _of_other_kinds(kinds, notices)
    views = [v for v in views if v.name not in others]
    instead = tuple(
        f"{name}: {what}" for name, gray in samples if (what := seen_instead(gray, spec))
    )
    if not views:
        if not kinds:
            raise NothingToDoError(
                "no pictures to search", "give images or a video of the board"
            )
        saw = (
            f"; instead {'; '.join(instead)}"
            if instead
            else "; no other board or marker either"
        )
        saw += "".join(f"; {n}" for n in notices)
        raise NothingToDoError(
            f"board {spec} is in none of {searched} pictures{saw}",
            "give the --board that was printed; a chessboard must be wholly in the picture,"
            " with a white margin",
        )
    if instead:
        notices.append("mixed boards or markers: " + "; ".join(instead) + " (not used)")
    return Found(spec, tuple(views), searched, tuple(empty), instead, tuple(notices))


def _of_other_kinds(
    kinds: Mapping[str, tuple[int, int, int]], notices: list[str]
) -> set[str]:
    """Names of the pictures that are not of the usual size, or upside down against the
    others; a notice says so.

    kinds : width, height and EXIF orientation by name. Raises InputError where no kind is
    that of most.
    """
    groups: dict[tuple[int, int, bool], list[str]] = defaultdict(list)
    for name, (width, height, turn) in kinds.items():
        groups[width, height, turn in UPSIDE_DOWN].append(name)
    if len(groups) < 2:
        return set()
    mixed = len({turn for _, _, turn in kinds.values()}) > 1
    words = {}
    for (width, height, _), names in groups.items():
        tags = (
            " by EXIF orientation"
            f" {', '.join(map(str, sorted({kinds[n][2] for n in names})))}"
            if mixed
            else ""
        )
        words[names[0]] = (
            f"{_first_names(names)} {'is' if len(names) == 1 else 'are'}"
            f" {width}x{height}{tags}"
        )
    most = max(groups.values(), key=len)
    cause = (
        "; their EXIF orientations are mixed: the camera was turned, or its tags are wrong"
        if mixed
        else ""
    )
    if 2 * len(most) <= len(kinds):
        raise InputError(
            "pictures of different sizes or orientations:"
            f" {', '.join(words.values())}{cause}",
            "a calibration belongs to one size and orientation: give those of one camera"
            " mode, held one way"
            + (
                " (if they are, exiftool -Orientation=1 -n mends the tags)"
                if mixed
                else ""
            ),
        )
    usual = words.pop(most[0])
    notices.append(f"left out: {', '.join(words.values())}; {usual}{cause}")
    return set(kinds) - set(most)


def calibrate(found: Found, keep: int = KEEP_VIEWS) -> Calibration:
    """Intrinsics from the views found.

    Raises NothingToDoError if fewer than three different views agree.
    """
    notices = list(found.notices)
    unique, copies = drop_copies(found.views)
    unique = most_varied(unique, keep)
    if len(unique) < 3:
        raise NothingToDoError(
            f"board {found.spec} is seen in {len(found.views)} of {found.searched}"
            f" pictures, {len(unique)} of them different"
            + "".join(f"; {n}" for n in found.notices),
            "at least 3 different views are needed, 15 are good",
        )
    # twice: with a rich model the views' errors are smaller, and a bad view stands out that
    # hid behind the lens's distortion
    first_fit, rejected = reject_views(unique)
    chosen, _ = choose_model(first_fit.views)
    again, rejected = reject_views(unique, chosen.model)
    trimmed, corners_dropped = drop_corners(again)
    chosen, table = choose_model(trimmed)
    fitted = chosen.fitted or again
    known = uncertainty(fitted)
    seen = coverage(fitted)
    focal_sd = float(max(known.standard_deviations[:2]))
    projection = projection_uncertainty_px(fitted, known)
    measured = figures(
        fitted, seen, focal_sd, projection, chosen.held_out_rms_px, len(rejected)
    )
    word, reasons = judge(measured)
    oriented = [v for v in fitted.views if v.upside_down is not None]
    usually = sum(bool(v.upside_down) for v in oriented) * 2 > len(oriented)
    turned = tuple(v.name for v in oriented if v.upside_down != usually)
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
    if found.spec.turn_is_ambiguous and found.spec.kind == CHESSBOARD:
        notices.append(
            f"a {found.spec.columns}x{found.spec.rows} chessboard looks the same after half"
            " a turn: which views are upside down cannot be known (the intrinsics do not"
            " suffer; one odd and one even count avoids it)"
        )
    if found.empty:
        notices.append(
            f"no board in {len(found.empty)} of {found.searched} pictures:"
            f" {_first_names(found.empty)}"
        )
    if corners_dropped:
        notices.append(f"{corners_dropped} corners miss by far and are left out")
    verdict = Verdict(word, reasons, next_picture(seen))
    return Calibration(
        found.spec,
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
    return ", ".join(names[:5]) + (
        f" and {len(names) - 5} more" if len(names) > 5 else ""
    )
